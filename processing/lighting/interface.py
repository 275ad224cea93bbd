"""What skin's surface lets through: light that enters a diffuse layer below a rough dielectric.

Of light from a direction of cosine c the facets mirror the share R(c, m); T = 1 - R enters. By
reciprocity what leaves the layer is let out by the same T toward the camera, and dividing by T's
mean makes the diffuse albedo exitant over incident of what entered.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numba import njit

from processing.lighting.facets import BECKMANN, Facets
from processing.lighting.fresnel import fresnel

INDEX = 1.4
ROUGHNESS_RANGE = (0.15, 0.35)
"""m of the table's first and last row; a row for each .05."""
ROWS = 5
ENTERED_SHARE = "light_that_enters"
"""The fact of `refine` that has `Interface.entered_share` for the face."""
COSINES = 40
"""Steps of the table over the cosine."""


@dataclasses.dataclass(frozen=True)
class Interface:
    """T tabulated.

    Attributes:
        table: (ROWS, COSINES + 1) float32 T over m and cosine.
        mean: (ROWS,) float32 cosine-weighted mean of T.
        facets: that mirror.
    """

    table: np.ndarray
    mean: np.ndarray
    facets: Facets = BECKMANN

    def entered_share(self, roughness: float) -> float:
        """Cosine-weighted mean of T at a width: what enters of light that comes from all around.

        A diffuse albedo of the light that entered, times this, is one of the light that fell on
        the skin: what a renderer without an interface calls albedo.
        """
        rows = np.linspace(*ROUGHNESS_RANGE, len(self.mean))
        return float(np.interp(roughness, rows, self.mean))


BARE = Interface(
    np.ones((ROWS, COSINES + 1), np.float32),
    np.ones(ROWS, np.float32),
)
"""A Lambertian surface without any interface: T = 1."""


@functools.cache
def skin_interface(facets: Facets = BECKMANN) -> Interface:
    """T of n = 1.4, by the sum of the lobe over directions of light.

    A stretched lobe lets through what a round one of the same m does. Facets that cover nothing
    let all light through.

    Source: [Walter2007] for the lobe.
    """
    if not facets.covers:
        return dataclasses.replace(BARE, facets=facets)
    if facets.stretch != 1 or not facets.rises:
        plain = skin_interface(Facets(facets.tails))
        return dataclasses.replace(plain, facets=facets)
    rows = np.linspace(*ROUGHNESS_RANGE, ROWS)
    cosines = np.linspace(0, 1, COSINES + 1)
    table = np.stack([[1 - mirrored(max(c, 0.01), m, facets.tails) for c in cosines] for m in rows])
    mean = np.trapezoid(2 * cosines * table, cosines, axis=1)
    return Interface(table.astype(np.float32), mean.astype(np.float32), facets)


def mirrored(cosine: float, roughness: float, tails: bool = False, steps: int = 72) -> float:
    """R: the share that facets mirror of light that comes from a direction.

    Args:
        cosine: of the direction, above 0.
        roughness: m.
        tails: of GGX in place of Beckmann's distribution.
        steps: of the polar angle and of half the azimuth.
    """
    angle = (np.arange(steps) + 0.5) / steps
    theta, phi = np.meshgrid(angle * np.pi / 2, angle * np.pi, indexing="ij")
    x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    hx, hz = x - np.sqrt(1 - cosine**2), z + cosine
    length = np.sqrt(hx**2 + y**2 + hz**2)
    nh2 = (hz / length) ** 2
    c = (cosine * hz - np.sqrt(1 - cosine**2) * hx) / length
    steep = (1 - nh2) / (nh2 * roughness**2)
    density = (1 / (1 + steep) ** 2 if tails else np.exp(-steep)) / (np.pi * roughness**2 * nh2**2)
    share = fresnel(((INDEX - 1) / (INDEX + 1)) ** 2, c)
    hidden = smith(z, roughness, tails) + smith(np.array(cosine), roughness, tails)
    lobe = density * share / (1 + hidden)
    solid = np.sin(theta) * (np.pi / 2 / steps) * (2 * np.pi / steps)
    return float((lobe * solid).sum() / (4 * cosine))


def smith(cosine: np.ndarray, roughness: float, tails: bool = False) -> np.ndarray:
    """Smith's Lambda at (...) cosines, exact for GGX, the rational fit for Beckmann."""
    sine = np.sqrt(np.maximum(1 - cosine**2, 1e-12))
    if tails:
        return np.asarray((np.sqrt(1 + (roughness * sine / cosine) ** 2) - 1) / 2)
    a = np.minimum(cosine / (roughness * sine), 1.6)
    fitted = (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2)
    return np.where(a < 1.6, fitted, 0.0)


@njit(cache=True, inline="always")
def row_of(roughness: float, rows: int) -> tuple[int, float]:
    """Row of the table and part of the way to the next."""
    first, last = ROUGHNESS_RANGE
    place = min(max((roughness - first) / (last - first), 0.0), 1.0) * (rows - 1)
    row = min(rows - 2, int(place))
    return row, place - row


@njit(cache=True, inline="always")
def let_through(table: np.ndarray, row: int, part: float, cosine: float) -> float:
    """T at a place of the (rows, columns) table."""
    steps = table.shape[1] - 1
    place = min(max(cosine, 0.0), 1.0) * steps
    column = min(steps - 1, int(place))
    across = place - column
    above = table[row, column] * (1 - across) + table[row, column + 1] * across
    below = table[row + 1, column] * (1 - across) + table[row + 1, column + 1] * across
    return above * (1 - part) + below * part
