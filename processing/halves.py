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
def half_value(typing: Any, bits: Any) -> Any:
    """float32 of a half float's uint16 bits (compiled code only); exact."""
    del typing
    if bits != types.uint16:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del context, signature
        return builder.fpext(builder.bitcast(arguments[0], ir.HalfType()), ir.FloatType())

    return types.float32(types.uint16), generate
