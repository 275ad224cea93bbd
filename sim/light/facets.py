"""The mirror of skin: a dielectric's Fresnel reflectance on Beckmann or GGX facets.

Small compiled functions that `sim.light.render` calls for every pixel and light (float32) and
`sim.light.transmittance` integrates (float64). A lobe is round (one m) or stretched: m_u along a
tangent, m_v across it. `slope` is m times the sine of a direction's angle to the normal; of a
stretched lobe sqrt((m_u x)^2 + (m_v y)^2), x and y the direction's components along and across.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

SKIN_INDEX = 1.4
"""Refractive index of skin's surface: its reflectance at normal incidence is .0278."""
SKIN_F0 = ((SKIN_INDEX - 1) / (SKIN_INDEX + 1)) ** 2
DISTRIBUTIONS = ("beckmann", "ggx")

# Plain Python numbers are float64 to the compiler and would slow float32 work down.
_0: Any = np.float32(0.0)
_HALF: Any = np.float32(0.5)
_1: Any = np.float32(1.0)
_FAR_SLOPE: Any = np.float32(1.6)
_A: Any = np.float32(1.259)
_B: Any = np.float32(0.396)
_C: Any = np.float32(3.535)
_D: Any = np.float32(2.181)


@numba.njit(cache=True, inline="always", error_model="numpy")
def fresnel_dielectric(index: float, cosine: float) -> float:
    """Unpolarised reflectance of a dielectric, exact [CookTorrance1982].

    Args:
        index: of refraction, at least 1; the float type of the result.
        cosine: of the angle between the half vector and the light, 0..1.
    """
    g = math.sqrt(index * index - _1 + cosine * cosine)
    minus, plus = g - cosine, g + cosine
    below = cosine * minus + _1
    inverse = _1 / (plus * below)
    first = minus * below * inverse
    second = (cosine * plus - _1) * plus * inverse
    return _HALF * first * first * (_1 + second * second)


@numba.njit(cache=True, inline="always", error_model="numpy")
def beckmann_lambda(cosine: float, slope: float) -> float:
    """Smith's Lambda of Beckmann's distribution, rational fit [Walter2007]."""
    if slope * _FAR_SLOPE <= cosine:
        return _0 * cosine
    a = cosine / slope
    return (_1 - _A * a + _B * a * a) / (_C * a + _D * a * a)


@numba.njit(cache=True, inline="always", error_model="numpy")
def ggx_lambda(cosine: float, slope: float) -> float:
    """Smith's Lambda of GGX, exact [Walter2007]."""
    a = slope / cosine
    return (math.sqrt(_1 + a * a) - _1) * _HALF


@numba.njit(cache=True, inline="always", error_model="numpy")
def beckmann_density(n_h2: float, tilt: float, area: float) -> float:
    """The number pi times Beckmann's distribution [Walter2007].

    Args:
        n_h2: squared cosine between normal and half vector, above 0.
        tilt: (x / m_u)^2 + (y / m_v)^2 of the half vector; of a round lobe (1 - n_h2) / m^2.
        area: m_u m_v.
    """
    return math.exp(-tilt / n_h2) / (area * n_h2 * n_h2)


@numba.njit(cache=True, inline="always", error_model="numpy")
def ggx_density(n_h2: float, tilt: float, area: float) -> float:
    """The number pi times the GGX distribution [Walter2007]; arguments as `beckmann_density`."""
    wide = n_h2 + tilt
    return _1 / (area * wide * wide)
