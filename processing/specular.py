"""Skin's gloss on the mesh: specular albedo and lobe width that explain all views together.

One pixel's seven readings hold too little of its mirror reflection to beat a constant. The readings
of many pixels, views and patterns are summed at the mesh's vertices as least-squares evidence for
a few lobe widths; after pooling over some millimetres the width that leaves the smallest residual
is taken, and the specular albedo that belongs to it.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import sparse

from processing.albedo import specular_evidence
from processing.interface import skin_interface
from processing.lights import PatternLights, Shadows
from processing.lobe import transport


@dataclasses.dataclass(frozen=True)
class Gloss:
    """Beckmann's m and the reflectance at normal incidence: (V,) each."""

    roughness: np.ndarray
    specular: np.ndarray


@dataclasses.dataclass
class GlossSums:
    """Evidence at V vertices for M lobe widths.

    Attributes:
        roughness: (M,) Beckmann's m, ascending.
        weighed, weight: (M, V) sums of `specular_evidence`.
        power: (M, V) sums of what the diffuse part alone leaves unexplained, squared.
        count: (V,) pixels.
    """

    roughness: np.ndarray
    weighed: np.ndarray
    weight: np.ndarray
    power: np.ndarray
    count: np.ndarray


def no_sums(roughness: tuple[float, ...], vertices: int) -> GlossSums:
    """Sums before any view was added."""
    zeros = np.zeros((3, len(roughness), vertices))
    return GlossSums(np.array(roughness), zeros[0], zeros[1], zeros[2], np.zeros(vertices))


def add_view(
    sums: GlossSums,
    lights: PatternLights,
    mean: np.ndarray,
    points_mm: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    shadows: Shadows,
    trust: np.ndarray,
) -> None:
    """Add one view's pixels to the sums.

    Args:
        sums: changed in place.
        lights: of P patterns.
        mean: (n, P) mean channel of the readings, in the lights' own colour.
        points_mm, normals, views: (n, 3) of the pixels.
        shadows: lights that the pixels see; its corners are the vertices that the sums are kept at.
        trust: (n,) weight of each pixel, 0..1.
    """
    vertices = len(sums.count)
    share = shadows.weights * trust[:, None]
    corners = shadows.corners.ravel()

    def summed(values: np.ndarray) -> np.ndarray:
        return np.bincount(corners, (share * values[:, None]).ravel(), minlength=vertices)

    sums.count += summed(np.ones(len(mean)))
    for index, roughness in enumerate(sums.roughness):
        e, lobe = transport(
            lights, points_mm, normals, views, float(roughness), shadows, skin_interface()
        )
        evidence = specular_evidence(mean, e, lobe)
        sums.weighed[index] += summed(evidence.weighed)
        sums.weight[index] += summed(evidence.weight)
        sums.power[index] += summed(evidence.power)


def solve_gloss(
    sums: GlossSums,
    average: sparse.csr_array,
    *,
    rounds_roughness: int,
    rounds_specular: int,
    prior_specular: float,
    prior_pixels: float,
) -> Gloss:
    """Lobe width and specular albedo of every vertex.

    Args:
        sums: of all views.
        average: (V, V) one round of averaging over neighbours.
        rounds_roughness, rounds_specular: of pooling.
        prior_specular: taken where there is no evidence at all.
        prior_pixels: the whole face's own answer counts as this many typical pixels at a vertex.

    Returns:
        Gloss, finite everywhere.
    """
    if not sums.weight.sum() > 0:
        middle = float(sums.roughness[len(sums.roughness) // 2])
        same = np.ones(len(sums.count))
        return Gloss(middle * same, prior_specular * same)
    roughness = _roughness(sums, average, rounds_roughness, prior_pixels)
    weighed, weight = (_smooth(x, average, rounds_specular) for x in (sums.weighed, sums.weight))
    whole = sums.weighed.sum(axis=1) / np.maximum(sums.weight.sum(axis=1), 1e-30)
    typical = sums.weight.sum(axis=1) / sums.count.sum() * prior_pixels
    between = _between(sums.roughness, roughness)
    top = _pick(weighed, between) + _pick((typical * whole)[:, None], between)
    bottom = _pick(weight, between) + _pick(typical[:, None], between)
    return Gloss(roughness, np.clip(top / bottom, 0.0, 0.2))


def _roughness(
    sums: GlossSums, average: sparse.csr_array, rounds: int, prior_pixels: float
) -> np.ndarray:
    """(V,) the lowest point of a parabola through the residuals of the M lobe widths."""
    weighed, weight, power = (
        _smooth(x, average, rounds) for x in (sums.weighed, sums.weight, sums.power)
    )
    here = power - weighed**2 / np.maximum(weight, 1e-30)
    total = sums.power.sum(axis=1)
    total -= sums.weighed.sum(axis=1) ** 2 / np.maximum(sums.weight.sum(axis=1), 1e-30)
    residual = here + total[:, None] / sums.count.sum() * prior_pixels
    m = sums.roughness
    curve, slope, _ = np.polyfit(m, residual, 2)
    hollow = curve > 0
    best = np.where(hollow, -slope / np.where(hollow, 2 * curve, 1), m[np.argmin(total)])
    return np.asarray(np.clip(best, m[0], m[-1]))


def _smooth(values: np.ndarray, average: sparse.csr_array, rounds: int) -> np.ndarray:
    columns = values.T
    for _ in range(rounds):
        columns = average @ columns
    return np.asarray(columns.T)


def _between(grid: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    below = np.clip(np.searchsorted(grid, values) - 1, 0, len(grid) - 2)
    return below, (values - grid[below]) / (grid[below + 1] - grid[below])


def _pick(table: np.ndarray, between: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Linear interpolation in an (M, V) or (M, 1) table, one place a vertex."""
    below, part = between
    column = np.arange(len(below)) if table.shape[1] > 1 else 0
    return np.asarray(table[below, column] * (1 - part) + table[below + 1, column] * part)
