"""Half floats in compiled code: numba knows no float16, so their bits travel as uint16."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LARGEST = 65504.0
"""The largest finite half float."""


@intrinsic
def half_bits(typing: Any, value: Any) -> Any:
    """uint16 bits of the half float nearest to a float32, ties to even (compiled code only).

    It is the processor's own instruction (x86 since 2012, every 64-bit ARM), and a loop over it is
    vectorised. What is beyond `LARGEST` becomes infinite.
    """
    del typing
    if value != types.float32:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del context, signature
        return builder.bitcast(builder.fptrunc(arguments[0], ir.HalfType()), ir.IntType(16))

    return types.uint16(types.float32), generate


@intrinsic
def as_float(typing: Any, reading: Any) -> Any:
    """float32 of a half float's uint16 bits, exact; float32 as it is (compiled code only)."""
    del typing
    if reading not in (types.uint16, types.float32):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del context
        if signature.args[0] == types.float32:
            return arguments[0]
        return builder.fpext(builder.bitcast(arguments[0], ir.HalfType()), ir.FloatType())

    return types.float32(reading), generate
