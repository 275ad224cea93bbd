"""Half floats to float32 and back: bit for bit what numpy gives, by the processor itself.

Numba knows no float16, so in compiled code half floats travel as their bits, uint16.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

LARGEST = 65504.0
"""The largest finite half float."""
_SPECIAL = 0x7C00
"""The exponent of infinities and NaN."""
_SIZE = 0x7FFF
"""All bits but the sign."""


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


def float_from_half(half: np.ndarray) -> tuple[np.ndarray, bool]:
    """Widen.

    Args:
        half: float16 of any shape.

    Returns:
        float32 of that shape, C-contiguous, and whether all of it is finite.
    """
    bits = np.ascontiguousarray(half).view(np.uint16)
    out = np.empty(bits.shape, np.float32)
    special = _widen(bits.reshape(-1), out.reshape(-1))
    return out, special == 0


def half_from_float(values: np.ndarray) -> tuple[np.ndarray, bool]:
    """Round float32 to the nearest half float, ties to even; too large ones become infinite.

    Args:
        values: float32 of any shape.

    Returns:
        float16 of that shape, C-contiguous, and whether no value is larger than half floats hold
        (65504; infinities are, NaN are not).
    """
    given = np.ascontiguousarray(values, np.float32)
    out = np.empty(given.shape, np.uint16)
    large = _narrow(given.reshape(-1), out.reshape(-1))
    return out.view(np.float16), large == 0


def is_finite(half: np.ndarray) -> bool:
    """Whether no value is NaN or infinite.

    Args:
        half: float16 of any shape, C-contiguous.
    """
    return bool(_count(half.view(np.uint16).reshape(-1), _SPECIAL) == 0)


def has_infinity(half: np.ndarray) -> bool:
    """Whether a value is infinite; NaN are not.

    Args:
        half: float16 of any shape, C-contiguous.
    """
    return bool(_count(half.view(np.uint16).reshape(-1), _SIZE) > 0)


@njit(cache=True, nogil=True)
def _count(bits: np.ndarray, looked_at: int) -> int:
    """How many are infinite as far as some bits show; by the exponent alone NaN count, too."""
    count = 0
    for i in range(len(bits)):
        count += (bits[i] & looked_at) == _SPECIAL
    return count


@njit(cache=True, nogil=True)
def _widen(bits: np.ndarray, out: np.ndarray) -> int:
    """Fill `out`; how many are not finite."""
    special = 0
    for i in range(len(bits)):
        special += (bits[i] & _SPECIAL) == _SPECIAL
        out[i] = as_float(bits[i])
    return special


@njit(cache=True, nogil=True)
def _narrow(values: np.ndarray, out: np.ndarray) -> int:
    """Fill `out`; how many values are too large."""
    large = 0
    for i in range(len(values)):
        large += abs(values[i]) > LARGEST
        out[i] = half_bits(values[i])
    return large
