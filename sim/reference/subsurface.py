"""Light that wanders inside the skin: a sum of six Gaussians over the surface [DEon2007].

U is the light that entered, per area. What leaves, before the skin's colour takes its share, is

    S = U + Q U - (Q 1) U,    Q U (x) = sum_y sqrt(c_x c_y) G(|x - y|) U(y) area(y)

with c the translucency: 0 keeps the light where it entered, 1 gives the whole profile. Q is
symmetric, so S keeps energy, and leaves a uniform U alone whatever c does. Light does not cross
between surfaces that turn away from each other, such as closed lips.
"""

from __future__ import annotations

import numba
import numpy as np

from sim.reference.texels import Texels

VARIANCES_MM2 = (0.0064, 0.0484, 0.187, 0.567, 1.99, 7.41)
PROFILE = np.array(
    [
        [0.233, 0.455, 0.649],
        [0.100, 0.336, 0.344],
        [0.118, 0.198, 0.000],
        [0.113, 0.007, 0.007],
        [0.358, 0.004, 0.000],
        [0.078, 0.000, 0.000],
    ]
)
PROFILE /= PROFILE.sum(axis=0)
"""(6, 3) share of each Gaussian in red, green and blue."""
REACH = 3.2
"""Gaussians are cut at so many standard deviations; what is cut stays where it entered."""
FINEST = 0.5
"""A Gaussian narrower than this share of the texels' spacing stays where it entered."""


def diffuse_inside(
    texels: Texels, entered: np.ndarray, translucency: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What arrives at each texel from others, and which share of its own light it keeps.

    Args:
        texels: n patches.
        entered: (n, s, 3) light that entered the skin.
        translucency: (n,) 0..1.

    Returns:
        Q U (n, s, 3) and 1 - Q 1 (n, 3), float32.
    """
    count, states, _ = entered.shape
    root = np.sqrt(np.clip(translucency, 0, 1)).astype(np.float32)[:, None]
    columns = np.concatenate([entered.reshape(count, -1), np.ones((count, 1))], axis=1)
    columns = (columns * root).astype(np.float32)
    arrived = np.zeros((count, states, 3), np.float32)
    left = np.zeros((count, 3), np.float32)
    for variance, share in zip(VARIANCES_MM2, PROFILE, strict=True):
        step = layer_step(variance, texels.spacing_mm)
        if step == 0:
            continue
        moved = spread_gaussian(texels, columns, variance, step) * root
        arrived += moved[:, :-1].reshape(count, states, 3) * share
        left += moved[:, -1:] * share
    return arrived, 1.0 - left


def layer_step(variance: float, spacing_mm: float) -> int:
    """Texels between the nodes on which a Gaussian is summed; 0 where it stays within a texel."""
    sigma = variance**0.5
    if sigma < FINEST * spacing_mm:
        return 0
    step = 1
    while 2 * step * spacing_mm <= sigma and step < 16:
        step *= 2
    return step


def spread_gaussian(texels: Texels, columns: np.ndarray, variance: float, step: int) -> np.ndarray:
    """(n, k) columns smeared over the surface by one Gaussian of this variance in mm^2."""
    if step == 1:
        position, normal, area = texels.points.position, texels.points.smooth, texels.area
        return gaussian_sum(position, normal, area, np.zeros(len(area)), columns, variance)
    nodes = texels.nodes(step)
    summed = gaussian_sum(
        nodes.position, nodes.normal, nodes.area, nodes.spread, nodes.gather(columns), variance
    )
    return nodes.spread_out(summed)


def gaussian_sum(
    position: np.ndarray,
    normal: np.ndarray,
    area: np.ndarray,
    spread: np.ndarray,
    values: np.ndarray,
    variance: float,
) -> np.ndarray:
    """Sums over neighbours of Gaussian times area times value.

    Where neighbours crowd, as in a fold, weights are scaled down on both sides alike, so that
    none receives more than a whole.

    Args:
        position: (n, 3) mm.
        normal: (n, 3) unit.
        area: (n,) mm^2.
        spread: (n,) mm^2 by which gathering has smeared each value already.
        values: (n, k).
        variance: mm^2.

    Returns:
        (n, k) float32.
    """
    place = np.asarray(position, np.float64)
    cell = np.floor((place - place.min(axis=0)) / (REACH * variance**0.5)).astype(np.int64) + 1
    size = cell.max(axis=0) + 2
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    cells, starts = np.unique(key[order], return_index=True)
    starts = np.append(starts, len(key))
    steps = np.array([a * size[1] * size[2] + b * size[2] for a in (-1, 0, 1) for b in (-1, 0, 1)])
    sorted_ = [np.ascontiguousarray(a[order], np.float32) for a in (place, normal, area, spread)]
    columns = np.ascontiguousarray(values[order], np.float32)
    whole = np.ones((len(order), 1), np.float32)
    crowd = np.zeros((len(order), 1), np.float32)
    _sum(cells, starts, steps, *sorted_, np.ones(len(order), np.float32), whole, variance, crowd)
    scale = 1.0 / np.sqrt(np.maximum(crowd[:, 0], 1.0))
    summed = np.zeros_like(columns)
    _sum(cells, starts, steps, *sorted_, scale, columns, variance, summed)
    out = np.empty_like(summed)
    out[order] = summed
    return out


@numba.njit(cache=True, parallel=True)
def _sum(
    cells: np.ndarray,
    starts: np.ndarray,
    steps: np.ndarray,
    position: np.ndarray,
    normal: np.ndarray,
    area: np.ndarray,
    spread: np.ndarray,
    scale: np.ndarray,
    values: np.ndarray,
    variance: float,
    out: np.ndarray,
) -> None:
    """Fill out (n, k): entries sorted by cell, whose neighbours are rows of three cells."""
    reach2 = np.float32(REACH * REACH * variance)
    least = np.float32(0.1 * variance)
    channels = values.shape[1]
    for c in numba.prange(len(cells)):
        first = np.empty(len(steps), np.int64)
        last = np.empty(len(steps), np.int64)
        for r in range(len(steps)):
            middle = cells[c] + steps[r]
            first[r] = starts[np.searchsorted(cells, middle - 1)]
            last[r] = starts[np.searchsorted(cells, middle + 2)]
        for i in range(starts[c], starts[c + 1]):
            for r in range(len(steps)):
                for j in range(first[r], last[r]):
                    dx = position[i, 0] - position[j, 0]
                    dy = position[i, 1] - position[j, 1]
                    dz = position[i, 2] - position[j, 2]
                    d2 = dx * dx + dy * dy + dz * dz
                    if not d2 < reach2:
                        continue
                    facing = (
                        normal[i, 0] * normal[j, 0]
                        + normal[i, 1] * normal[j, 1]
                        + normal[i, 2] * normal[j, 2]
                    )
                    if not facing > 0.0:
                        continue
                    v = max(np.float32(variance) - spread[i] - spread[j], least)
                    weight = np.exp(np.float32(-0.5) * d2 / v) / (np.float32(2 * np.pi) * v)
                    weight *= area[j] * scale[i] * scale[j]
                    for k in range(channels):
                        out[i, k] += weight * values[j, k]
