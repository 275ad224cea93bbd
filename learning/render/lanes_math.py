"""Powers for compiled loops over texels: plain arithmetic that the compiler turns into vectors.

The C library's `exp` and `log` are calls, and a loop with a call in it is not made into vectors.
In float32 both are short polynomials here (largest error 2 units in the last place on the range
used); in float64 they are the library's, since double precision serves tests and not speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload
from numpy.polynomial import chebyshev, polynomial

ANY_ORDER = {"reassoc", "contract", "nsz", "arcp"}
"""Sums in any order and products by reciprocals; NaN and infinity stay what they are."""


def _series(
    function: Callable[[np.ndarray], np.ndarray], low: float, high: float, degree: int
) -> tuple:
    """Coefficients, lowest power first, of a function's Chebyshev fit on a range."""
    fit = chebyshev.Chebyshev.interpolate(function, degree, [low, high])
    return tuple(fit.convert(kind=polynomial.Polynomial).coef.tolist())


# An even count of nodes leaves f = 0 out, where ln(1 + f) / f is 0 / 0.
LOG_SERIES = _series(lambda f: np.log1p(f) / f, math.sqrt(0.5) - 1, math.sqrt(2.0) - 1, 9)
EXP_SERIES = _series(np.exp2, -0.5, 0.5, 6)
LOG_TERMS, EXP_TERMS = len(LOG_SERIES), len(EXP_SERIES)


@intrinsic
def _bits_of(typing_context: Any, value: Any) -> Any:
    del typing_context, value

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        return builder.bitcast(args[0], ir.IntType(32))

    return types.int32(types.float32), code


@intrinsic
def _float_of(typing_context: Any, bits: Any) -> Any:
    del typing_context, bits

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        return builder.bitcast(args[0], ir.FloatType())

    return types.float32(types.int32), code


def _log_single(x: Any) -> Any:
    """Natural logarithm of a positive normal float32: x = m 2^e, m in 0.7..1.41, then a series."""
    one = np.float32(1.0)
    # The exponent is counted from 0.7071, so that near 1, where it matters most, e is 0.
    shifted = _bits_of(x) - np.int32(0x3F3504F3)
    e = np.float32(shifted >> np.int32(23))
    f = _float_of((shifted & np.int32(0x007FFFFF)) + np.int32(0x3F3504F3)) - one
    y = np.float32(LOG_SERIES[-1])
    for k in range(LOG_TERMS - 2, -1, -1):
        y = y * f + np.float32(LOG_SERIES[k])
    return e * np.float32(0.6931471805599453) + f * y


def _exp_single(x: Any) -> Any:
    """e^x in float32 for x <= 0; below -87 it is 1.6e-38."""
    x = np.float32(-87.0) if x < np.float32(-87.0) else x
    turns = x * np.float32(1.4426950408889634)
    n = np.int32(turns - np.float32(0.5))
    r = turns - np.float32(n)
    y = np.float32(EXP_SERIES[-1])
    for k in range(EXP_TERMS - 2, -1, -1):
        y = y * r + np.float32(EXP_SERIES[k])
    return y * _float_of((n + np.int32(127)) << np.int32(23))


def log(x: Any) -> Any:
    """Ln x, for x > 0, of the argument's own precision (inside compiled code only)."""
    return math.log(x)


def exp(x: Any) -> Any:
    """e^x, for x <= 0, of the argument's own precision (inside compiled code only)."""
    return math.exp(x)


def _log_double(x: Any) -> Any:
    return math.log(x)


def _exp_double(x: Any) -> Any:
    return math.exp(x)


@overload(log)
def _log(x: Any) -> Any:
    return _log_single if x is types.float32 else _log_double


@overload(exp)
def _exp(x: Any) -> Any:
    return _exp_single if x is types.float32 else _exp_double
