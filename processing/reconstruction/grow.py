"""A view's surface grown pixel by pixel from its confirmed ones, by matches and by normals."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

NONE, CONFIRMED, MATCHED, CARRIED = 0, 1, 2, 3
"""Where a pixel's depth comes from: nowhere, several views, one view's match, normals alone."""

WINDOW_PX = 2
FEWEST = 3
"""Neighbours within the window that a pixel is carried on from, at least."""
JUMP_MM = 1.0
"""Neighbours whose planes miss each other by more are not on one surface."""


class Grown(NamedTuple):
    """A view's surface.

    Attributes:
        depth: (h, w) float64 ln of inverse depth, NaN where there is none.
        kind: (h, w) int8, of NONE to CARRIED.
        risk_mm: (h, w) float32 by how much it may be off since it left the last match.
    """

    depth: np.ndarray
    kind: np.ndarray
    risk_mm: np.ndarray


def grow(
    confirmed: np.ndarray,
    matched: np.ndarray,
    slopes: np.ndarray,
    doubt: np.ndarray,
    cosine: np.ndarray,
    agree_mm: float,
    carry_mm: float,
    jump_mm: float = JUMP_MM,
) -> Grown:
    """Carry a view's surface on from its confirmed pixels.

    Args:
        confirmed: (h, w) ln of inverse depth (1/mm), NaN where no other view agrees.
        matched: (h, w) the view's own, NaN where nothing was matched well.
        slopes: (h, w, 2) of `slopes.plane_slopes`.
        doubt: (h, w) by how much the slopes may be off.
        cosine: (h, w) of the normal to the line of sight, 0 where the surface may not go.
        agree_mm: a match agrees with the surface within this along the normal.
        carry_mm: without matches the surface continues until it may be off by this.
        jump_mm: see JUMP_MM.
    """
    depth = np.array(confirmed, np.float64)
    kind = np.where(np.isfinite(depth), CONFIRMED, NONE).astype(np.int8)
    risk = np.zeros(depth.shape, np.float32)
    left = np.stack(np.nonzero((kind == NONE) & (cosine > 0)), axis=1)
    found, taken = np.empty(len(left)), np.empty(len(left), np.int8)
    far = np.empty(len(left), np.float32)
    by_match = True
    while len(left):
        around = depth, kind, risk, matched, slopes, doubt, cosine
        _ring(left, *around, agree_mm, carry_mm, jump_mm, by_match, found, taken, far)
        new = taken[: len(left)] > NONE
        if not new.any() and not by_match:
            break
        at = left[new, 0], left[new, 1]
        for layer, values in ((depth, found), (kind, taken), (risk, far)):
            layer[at] = values[: len(left)][new]
        left = left[~new]
        # Where no match continues it, normals do for one ring; then matches are tried again.
        by_match = bool(new.any())
    return Grown(depth, kind, risk)


@njit(cache=True, parallel=True)
def _ring(
    left: np.ndarray,
    depth: np.ndarray,
    kind: np.ndarray,
    risk: np.ndarray,
    matched: np.ndarray,
    slopes: np.ndarray,
    doubt: np.ndarray,
    cosine: np.ndarray,
    agree_mm: float,
    carry_mm: float,
    jump_mm: float,
    by_match: bool,
    found: np.ndarray,
    taken: np.ndarray,
    far: np.ndarray,
) -> None:
    """What (n, 2) pixels take from the surface beside them: `found`, `taken`, `far`."""
    height, width = depth.shape
    for index in prange(len(left)):
        row, column = left[index, 0], left[index, 1]
        taken[index] = NONE
        low, high, total, count, nearest = math.inf, -math.inf, 0.0, 0, math.inf
        for y in range(max(row - WINDOW_PX, 0), min(row + WINDOW_PX + 1, height)):
            for x in range(max(column - WINDOW_PX, 0), min(column + WINDOW_PX + 1, width)):
                if kind[y, x] == NONE:
                    continue
                dx, dy = column - x, row - y
                z = depth[y, x] + 0.5 * (
                    (slopes[y, x, 0] + slopes[row, column, 0]) * dx
                    + (slopes[y, x, 1] + slopes[row, column, 1]) * dy
                )
                low, high, total, count = min(low, z), max(high, z), total + z, count + 1
                step = math.sqrt(dx * dx + dy * dy) * doubt[row, column] * math.exp(-z)
                nearest = min(nearest, risk[y, x] + step * cosine[row, column])
        if count < FEWEST:
            continue
        z = total / count
        distance = math.exp(-z)
        if not (high - low) * distance < jump_mm:
            continue
        if by_match:
            off = abs(matched[row, column] - z) * distance * cosine[row, column]
            if off < agree_mm + nearest:
                found[index], taken[index], far[index] = matched[row, column], MATCHED, 0.0
        elif nearest < carry_mm:
            found[index], taken[index], far[index] = z, CARRIED, nearest
