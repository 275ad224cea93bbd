"""Specular normals from mirror directions: which way a facet turns that mirrors what was seen.

A facet that mirrors the direction r into the camera at v has the normal of r + v. Ratios of the
specular light of a pair do not give r as it is: a lobe on one side of the splitting plane
gives no more than that, so that the ratio saturates like a step seen through the lobe. Here the
step is undone: the lobe of skin's width is summed over the stage's own lights for every r, and each
pixel takes the r whose light under all patterns is what it shows. Where that decides little,
because of noise, the normal stays where the diffuse one is.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit, prange

from processing.separation.config import MirrorConfig
from processing.separation.lobe_table import LobeTable, lobe_at, mirrored_to, width_place

TURN = 0.02
"""Tangent of the turns by which derivatives are taken: a grid cell of the table, about."""
LONGEST_TURN = 0.15
"""A step turns the normal by at most this tangent; the lobe is some 20 degrees wide."""


@dataclasses.dataclass(frozen=True)
class Mirrored:
    """Of n pixels.

    Attributes:
        normal: (n, 3) float64 unit, zero where the start is.
        sigma_rad: (n,) float64 what noise leaves open, at most the spread that was expected.
    """

    normal: np.ndarray
    sigma_rad: np.ndarray


def mirror_normals(
    specular: np.ndarray,
    sigma: np.ndarray,
    table: LobeTable,
    points_mm: np.ndarray,
    start: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray | float,
    config: MirrorConfig,
) -> Mirrored:
    """Normals that mirror the stage's lights as the specular part shows them.

    Args:
        specular: (n, P) readings less the diffuse part.
        sigma: (n, P) standard deviations of them; infinite for a reading that is not to be used.
        table: the lobe of the P patterns.
        points_mm: (n, 3) places of the pixels; 0 for the centre.
        start: (n, 3) unit diffuse normals, zero where there is none.
        views: (n, 3) unit, toward the camera.
        roughness: Beckmann's m, one or (n,).
        config: see there.

    Returns:
        Mirrored; the start where nothing is mirrored or something is not finite.

    Source: [Ma2007] for normals from the mirror direction.
    """
    count = len(specular)
    out = Mirrored(np.array(start, np.float64), np.zeros(count))
    _mirror(
        np.ascontiguousarray(specular, np.float64),
        np.ascontiguousarray(1 / np.maximum(sigma, 1e-30) ** 2, np.float64),
        table,
        np.ascontiguousarray(points_mm, np.float64),
        np.ascontiguousarray(views, np.float64),
        np.full(count, roughness, np.float64),
        math.radians(config.spread_deg),
        config.rounds,
        out.normal,
        out.sigma_rad,
    )
    return out


@njit(cache=True)
def two_across(n: np.ndarray, across: np.ndarray, up: np.ndarray) -> None:
    """Fill (3,) two unit directions across a (3,) unit normal and each other."""
    if abs(n[2]) < 0.9:
        length = math.sqrt(n[0] ** 2 + n[1] ** 2)
        across[0], across[1], across[2] = -n[1] / length, n[0] / length, 0.0
    else:
        length = math.sqrt(n[1] ** 2 + n[2] ** 2)
        across[0], across[1], across[2] = 0.0, -n[2] / length, n[1] / length
    up[0] = n[1] * across[2] - n[2] * across[1]
    up[1] = n[2] * across[0] - n[0] * across[2]
    up[2] = n[0] * across[1] - n[1] * across[0]


@njit(cache=True)
def turn_by(
    n: np.ndarray, across: np.ndarray, up: np.ndarray, a: float, b: float, out: np.ndarray
) -> None:
    """The (3,) normal n turned by tangents a and b along (3,) directions, into (3,) `out`."""
    for k in range(3):
        out[k] = n[k] + a * across[k] + b * up[k]
    length = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    for k in range(3):
        out[k] /= length


@njit(cache=True)
def _seen(
    table: LobeTable,
    layer: int,
    part: float,
    place: np.ndarray,
    n: np.ndarray,
    v: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill (P,) `out` with a facet's lobe but for a factor, since the specular albedo is free."""
    x, y, z = mirrored_to(table, place, n, v)
    lobe_at(table.values, layer, part, x, y, z, out)


@njit(parallel=True, cache=True)
def _mirror(
    specular: np.ndarray,
    weight: np.ndarray,
    table: LobeTable,
    points: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray,
    spread: float,
    rounds: int,
    normal: np.ndarray,
    sigma: np.ndarray,
) -> None:
    count = specular.shape[1]
    prior = 1 / (spread * spread)
    for i in prange(len(specular)):
        n = normal[i].copy()
        if not n[0] ** 2 + n[1] ** 2 + n[2] ** 2 > 0.5:
            continue
        sigma[i] = spread
        total = 0.0
        for k in range(count):
            total += weight[i, k] * specular[i, k]
        if not math.isfinite(total):
            continue
        layer, part = width_place(table.roughness, roughness[i])
        across, up, turned = np.zeros(3), np.zeros(3), np.zeros(3)
        two_across(n, across, up)
        here, right, left = np.zeros(count), np.zeros(count), np.zeros(count)
        above, below = np.zeros(count), np.zeros(count)
        a = b = 0.0
        information = 0.0
        for _ in range(rounds):
            turn_by(n, across, up, a, b, turned)
            _seen(table, layer, part, points[i], turned, views[i], here)
            turn_by(n, across, up, a + TURN, b, turned)
            _seen(table, layer, part, points[i], turned, views[i], right)
            turn_by(n, across, up, a - TURN, b, turned)
            _seen(table, layer, part, points[i], turned, views[i], left)
            turn_by(n, across, up, a, b + TURN, turned)
            _seen(table, layer, part, points[i], turned, views[i], above)
            turn_by(n, across, up, a, b - TURN, turned)
            _seen(table, layer, part, points[i], turned, views[i], below)
            shown = power = 0.0
            for k in range(count):
                shown += weight[i, k] * specular[i, k] * here[k]
                power += weight[i, k] * here[k] * here[k]
            if not (shown > 0 and power > 0):
                a = b = information = 0.0
                break
            s = shown / power
            # Derivatives with the albedo left free: what is along the lobe itself is no turn.
            along_a = along_b = 0.0
            for k in range(count):
                along_a += weight[i, k] * here[k] * (right[k] - left[k])
                along_b += weight[i, k] * here[k] * (above[k] - below[k])
            aa, ab, bb, ra, rb = prior, 0.0, prior, -prior * a, -prior * b
            for k in range(count):
                da = s * (right[k] - left[k] - along_a / power * here[k]) / (2 * TURN)
                db = s * (above[k] - below[k] - along_b / power * here[k]) / (2 * TURN)
                rest = specular[i, k] - s * here[k]
                aa += weight[i, k] * da * da
                ab += weight[i, k] * da * db
                bb += weight[i, k] * db * db
                ra += weight[i, k] * da * rest
                rb += weight[i, k] * db * rest
            det = aa * bb - ab * ab
            step_a, step_b = (bb * ra - ab * rb) / det, (aa * rb - ab * ra) / det
            longest = math.sqrt(step_a * step_a + step_b * step_b)
            if not longest < math.inf:
                a = b = information = 0.0
                break
            scale = min(1.0, LONGEST_TURN / max(longest, 1e-12))
            a += scale * step_a
            b += scale * step_b
            # The better known half of the two turns would flatter: the mean variance.
            information = 2 * det / (aa + bb)
        if math.isfinite(a) and math.isfinite(b) and information > 0:
            turn_by(n, across, up, a, b, normal[i])
            sigma[i] = min(spread, math.sqrt(1 / information))
