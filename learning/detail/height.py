"""Heights above a mesh from finer normals, by masked least squares in the texture.

Differences of height between neighbouring texels are wanted; the heights that have them are found
by conjugate gradients, preconditioned by the solution on a whole rectangle of even texels, which
the cosine transform gives at once [Simchony1990]. Heights are held to zero over longer distances,
where the mesh knows better than the normals do [Nehab2005].
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import fft

from learning.vectors import unit

TOLERANCE = 1e-4
"""Residual, relative to the right side's length, at which the search ends: a captured head's
heights are within a ten-thousandth of those at 1e-6 by then, in a third of the rounds."""
MOST_ROUNDS = 300
LEAST_FACING = 0.2
"""Cosine between a fine normal and the mesh's below which the fine one determines no height."""
BAND_ROWS = 256
"""Rows whose directions are compared at once: of a large texture all would take gigabytes."""
SEAM = 10.0
"""Times the median step between neighbours beyond which they are on two sides of a seam."""


@dataclasses.dataclass(frozen=True)
class Steps:
    """What is wanted of the differences between neighbours.

    Attributes:
        across: (rows, columns - 1) difference of height to the right neighbour, mm.
        down: (rows - 1, columns) to the one below, mm.
        across_weight: of each, 0 where it does not count.
        down_weight: the same.
        hold: (rows, columns) weight of a height's own square.
    """

    across: np.ndarray
    down: np.ndarray
    across_weight: np.ndarray
    down_weight: np.ndarray
    hold: np.ndarray


def heights_mm(
    position_mm: np.ndarray,
    base_normal: np.ndarray,
    fine_normal: np.ndarray,
    covered: np.ndarray,
    longest_mm: float,
) -> tuple[np.ndarray, int]:
    """Heights along the mesh's normals whose surface has the fine normals.

    A step e along the surface rises by -(n.e) / (n.m), n being the fine normal and m the mesh's:
    so that it is perpendicular to n. The rise by the mesh's own normal is subtracted.

    Args:
        position_mm: (rows, columns, 3) of the mesh.
        base_normal: (rows, columns, 3) unit, the mesh's.
        fine_normal: (rows, columns, 3) unit, the same axes; where there is none the mesh's counts.
        covered: (rows, columns) bool, where a surface is.
        longest_mm: length of the waves of relief that keep half of their height; the rest, and
            more of longer ones, is the mesh's.

    Returns:
        (rows, columns) float64 mm, zero outside, and the rounds of the search.
    """
    known = covered.copy()
    for vectors in (position_mm, base_normal, fine_normal):
        known &= np.isfinite(vectors).all(axis=2)
    across, across_mm, across_known = _rises(position_mm, base_normal, fine_normal, known, 1)
    down, down_mm, down_known = _rises(position_mm, base_normal, fine_normal, known, 0)
    # Where the caller has no use for them either, their memory is free for the search.
    del position_mm, base_normal, fine_normal, vectors
    wide, high = _typical(across_mm, across_known), _typical(down_mm, down_known)
    if not (wide > 0 and high > 0):
        return np.zeros(covered.shape), 0
    # A wave of length s has a slope of 2 pi / s times its height: where this is as heavy as the
    # hold, half of the wave remains.
    hold = known * (wide * high * (2 * np.pi / max(longest_mm, 1e-9)) ** 2)
    steps = Steps(
        across,
        down,
        across_known * (high / wide),
        down_known * (wide / high),
        hold,
    )
    return solve(steps, known)


def solve(
    steps: Steps, covered: np.ndarray, tolerance: float = TOLERANCE
) -> tuple[np.ndarray, int]:
    """The heights of least squares, by preconditioned conjugate gradients.

    Args:
        steps: what is wanted.
        covered: (rows, columns) bool; heights elsewhere are zero.
        tolerance: of the residual, of the right side's length.

    Returns:
        (rows, columns) float64, and the rounds.
    """
    wanted = _transposed(
        steps.across_weight * steps.across, steps.down_weight * steps.down, covered.shape
    )
    size = float(np.sqrt((wanted**2).sum()))
    found = np.zeros(covered.shape)
    if not size > 0:
        return found, 0
    precondition = _Rectangle(steps)
    residual = wanted
    direction = guess = precondition(residual)
    product = float((residual * guess).sum())
    for done in range(1, MOST_ROUNDS + 1):
        moved = _applied(steps, direction)
        length = product / float((direction * moved).sum())
        found += length * direction
        residual -= length * moved
        if float(np.sqrt((residual**2).sum())) <= tolerance * size:
            return found * covered, done
        guess = precondition(residual)
        before, product = product, float((residual * guess).sum())
        direction = guess + product / before * direction
    return found * covered, MOST_ROUNDS


class _Rectangle:
    """The solution on a whole rectangle whose texels all count the same [Ghiglia1994].

    Where no surface is nothing is wanted of the heights: there they are free to be smooth, which
    keeps the rounds few.
    """

    def __init__(self, steps: Steps) -> None:
        rows, columns = steps.hold.shape
        across = _mean_of_counted(steps.across_weight)
        down = _mean_of_counted(steps.down_weight)
        hold = _mean_of_counted(steps.hold)
        waves = across * (2 - 2 * np.cos(np.pi * np.arange(columns) / columns))[None, :]
        waves = waves + down * (2 - 2 * np.cos(np.pi * np.arange(rows) / rows))[:, None]
        # Only `hold` determines a constant; where it is 0 the constant stays as it is.
        self._scale = 1 / np.maximum(waves + hold, 1e-9 * max(across, down, 1e-30))

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        waves = fft.dctn(residual, norm="ortho", workers=-1)
        found: np.ndarray = fft.idctn(waves * self._scale, norm="ortho", workers=-1)
        return found


def _applied(steps: Steps, heights: np.ndarray) -> np.ndarray:
    """The normal equations' left side."""
    across = steps.across_weight * np.diff(heights, axis=1)
    down = steps.down_weight * np.diff(heights, axis=0)
    return _transposed(across, down, heights.shape) + steps.hold * heights


def _transposed(across: np.ndarray, down: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """What differences give back to their two texels."""
    out = np.zeros(shape)
    out[:, 1:] += across
    out[:, :-1] -= across
    out[1:] += down
    out[:-1] -= down
    return out


def _rises(
    position_mm: np.ndarray,
    base_normal: np.ndarray,
    fine_normal: np.ndarray,
    known: np.ndarray,
    axis: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rise to the next texel along an axis, how far it is in mm, and whether it counts."""
    rows, columns = (side - (i == axis) for i, side in enumerate(known.shape))
    rise, length = np.zeros((rows, columns)), np.zeros((rows, columns))
    for start in range(0, rows, BAND_ROWS):
        here = slice(start, start + BAND_ROWS)
        band = slice(start, min(rows, start + BAND_ROWS) + (axis == 0))
        there = known[band, :, None]
        position, base, fine = (
            np.where(there, vectors[band], 0).astype(float)
            for vectors in (position_mm, base_normal, fine_normal)
        )
        rise[here], length[here] = _rises_of(position, unit(base), unit(fine), axis)
    first, second = _neighbours(axis)
    both = known[first] & known[second]
    typical = float(np.median(length[both])) if both.any() else 0.0
    both &= (length > 0) & (length < SEAM * typical)
    rise[~both] = 0
    return rise, length, both


def _rises_of(
    position: np.ndarray, base: np.ndarray, fine: np.ndarray, axis: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rises and lengths of all steps along an axis."""
    facing = (fine * base).sum(axis=2) > LEAST_FACING
    fine = np.where(facing[..., None], fine, base)
    first, second = _neighbours(axis)
    step = position[second] - position[first]
    mesh = unit(base[first] + base[second])
    normal = unit(fine[first] + fine[second])
    facing = np.maximum((normal * mesh).sum(axis=2), LEAST_FACING)
    rise = (mesh * step).sum(axis=2) - (normal * step).sum(axis=2) / facing
    return rise, np.linalg.norm(step, axis=2)


def _neighbours(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """All texels of an image but the last along an axis, and all but the first."""
    first, second = (
        tuple(cut if i == axis else slice(None) for i in range(2))
        for cut in (slice(None, -1), slice(1, None))
    )
    return first, second


def _typical(length_mm: np.ndarray, known: np.ndarray) -> float:
    return float(np.median(length_mm[known])) if known.any() else 0.0


def _mean_of_counted(weight: np.ndarray) -> float:
    some = weight[weight > 0]
    return float(some.mean()) if some.size else 0.0
