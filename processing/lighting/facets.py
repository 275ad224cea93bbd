"""The families of mirror lobes: how the facets of a rough surface are inclined.

A facet's half vector h of cosine c to the normal has the steepness q = (x / m_u)^2 + (y / m_v)^2
over c^2, x and y its parts along and across a tangent; of a round lobe tan^2 / m^2. Beckmann's
distribution falls as exp(-q), that of GGX as 1 / (1 + q)^2: narrower, with long tails.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numba import njit

STEEPEST = 9.0
"""Beckmann's lobe is cut where its steepness is more (1e-4 of its middle)."""

# Plain numbers are float64 to the compiler, and make all float32 beside them so.
_0: Any = np.float32(0)
_1: Any = np.float32(1)


@dataclasses.dataclass(frozen=True)
class Facets:
    """One family, for a whole face.

    Attributes:
        tails: GGX in place of Beckmann's distribution.
        stretch: m_u is m times it, m_v is m over it; u is the horizontal tangent (of a world
            whose y is up), v goes up the surface. 1 is a round lobe.
        rises: they mirror more light toward grazing angles, by Fresnel's equations; else the same
            share at all angles.
        covers: the diffuse layer lies below them, so that they take light on its way in and out;
            else all light enters, as in programs that blend a mirror with a Lambertian surface.
    """

    tails: bool = False
    stretch: float = 1.0
    rises: bool = True
    covers: bool = True

    @property
    def shape(self) -> np.ndarray:
        """(2,) float32, as the kernels take it."""
        return np.array([self.tails, self.stretch], np.float32)

    @property
    def name(self) -> str:
        """For a report."""
        name = "GGX" if self.tails else "Beckmann"
        if self.stretch != 1:
            name += f", {self.stretch**2:.3g} times as wide sideways as upward"
        if not self.rises:
            name += ", the same share at all angles"
        return name if self.covers else f"{name}, over skin that all light enters"


BECKMANN = Facets()


@njit(cache=True)
def unmasked(cosine: float, slope: float, tails: bool) -> float:
    """Smith's G1, exact for GGX, the rational fit for Beckmann.

    Args:
        cosine: of the direction to the normal, above 0.
        slope: m times its sine; of a stretched lobe sqrt((m_u x)^2 + (m_v y)^2).
        tails: of GGX.

    Source: [Walter2007].
    """
    if tails:
        a = slope / cosine
        return 2 / (1 + math.sqrt(1 + a * a))
    if slope <= 0.625 * cosine:  # a = 1 / (m tan) >= 1.6
        return 1.0
    a = cosine / slope
    return (3.535 * a + 2.181 * a * a) / (1 + 2.276 * a + 2.577 * a * a)


@njit(cache=True, inline="always")
def horizontal(nx: float, nz: float) -> tuple[float, float]:
    """The x and z of the horizontal tangent of a unit normal; +x where the normal is upright."""
    length = math.sqrt(nx * nx + nz * nz)
    if length < 1e-6:
        return _1, _0
    return nz / length, -nx / length
