"""Numba kernels: a view's depth from a sweep of the coarsest level, propagation, small steps.

A half-sweep of `propagate` writes the pixels of one colour of a chequerboard and reads neighbours
of the other colour, so the result does not depend on the number of threads.

Numba types the index of a parallel loop with a sign when it infers types and without one when it
compiles the loop's body, and compiles a function that is called with it for both. Loops that call
functions of `patches` give them an index whose type they state.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from processing.reconstruction.patches import (
    FAST,
    HALF,
    NO_MATCH,
    ONE,
    ZERO,
    Stereo,
    gather_patch,
    new_patch,
    plane_cost,
)

SAME = np.float32(0.05)
"""A neighbour's plane nearer than this to a pixel's own depth (px of disparity) is not tried."""


@njit(cache=True, fastmath=FAST, parallel=True)
def sweep(
    stereo: Stereo,
    candidates: np.ndarray,
    masks: np.ndarray,
    hull_matrices: np.ndarray,
    hull_shifts: np.ndarray,
    inverse_depth: np.ndarray,
    cost: np.ndarray,
) -> None:
    """Try the same inverse depths at every pixel and keep the best.

    A point that any view shows as background is passed over (visual hull).

    Args:
        stereo: the views.
        candidates: (n,) inverse depths, 1/mm.
        masks: (views, h, w) bool, false where a view shows background.
        hull_matrices, hull_shifts: (views, 3, 3), (views, 3): M and m into every view.
        inverse_depth, cost: (h, w), filled; 0 and NO_MATCH where nothing fits.
    """
    picture = stereo.pictures[stereo.reference]
    height, width = picture.shape[0], picture.shape[1]
    for line in prange(height):
        patch = new_patch(stereo)
        row = np.int64(line)  # see the file's docstring
        for column in range(width):
            inverse_depth[row, column] = ZERO
            cost[row, column] = NO_MATCH
            if math.isnan(picture[row, column, 0]):
                continue
            count, floor = gather_patch(stereo, row, column, patch)
            a, b = stereo.slopes[row, column, 0], stereo.slopes[row, column, 1]
            for index in range(candidates.shape[0]):
                w = candidates[index]
                if not _inside_hull(masks, hull_matrices, hull_shifts, row, column, w):
                    continue
                found = plane_cost(stereo, row, column, (w, a, b), patch, count, floor)
                if found < cost[row, column]:
                    cost[row, column] = found
                    inverse_depth[row, column] = w


@njit(cache=True, fastmath=FAST)
def _inside_hull(
    masks: np.ndarray,
    matrices: np.ndarray,
    shifts: np.ndarray,
    row: int,
    column: int,
    w: np.float32,
) -> bool:
    height, width = masks.shape[1], masks.shape[2]
    u, v = np.float32(column) + HALF, np.float32(row) + HALF
    for k in range(masks.shape[0]):
        m, t = matrices[k], shifts[k]
        z = m[2, 0] * u + m[2, 1] * v + m[2, 2] + t[2] * w
        if not z > ZERO:
            continue
        x = math.floor((m[0, 0] * u + m[0, 1] * v + m[0, 2] + t[0] * w) / z)
        y = math.floor((m[1, 0] * u + m[1, 1] * v + m[1, 2] + t[1] * w) / z)
        inside = x >= 0 and y >= 0 and x < width and y < height
        if inside and not masks[k, y, x]:
            return False
    return True


@njit(cache=True, fastmath=FAST)
def roughness(
    stereo: Stereo, inverse_depth: np.ndarray, row: int, column: int, w: np.float32
) -> np.float32:
    """How far the planes of the four neighbours miss a point, each capped at a pixel's disparity.

    Args:
        stereo: the views.
        inverse_depth: (h, w), 0 where there is none.
        row, column: the point's pixel.
        w: its inverse depth.

    Returns:
        Mean over the neighbours that have a depth, 0..1; 0 where none has.
    """
    height, width = inverse_depth.shape
    slopes = stereo.slopes
    total, count = ZERO, ZERO
    for side in range(4):
        dx, dy = _side(side, 1)
        x, y = column + dx, row + dy
        if 0 <= x < width and 0 <= y < height and inverse_depth[y, x] > ZERO:
            # The mean slope of both pixels: exact to second order on a curved surface.
            a = HALF * (slopes[y, x, 0] + slopes[row, column, 0])
            b = HALF * (slopes[y, x, 1] + slopes[row, column, 1])
            there = inverse_depth[y, x] * (ONE - a * np.float32(dx) - b * np.float32(dy))
            total += min(abs(w - there) / stereo.step, ONE)
            count += ONE
    return total / count if count > ZERO else ZERO


@njit(cache=True, inline="always")
def _side(side: int, reach: int) -> tuple[int, int]:
    dx = reach if side == 0 else -reach if side == 1 else 0
    dy = reach if side == 2 else -reach if side == 3 else 0
    return dx, dy


@njit(cache=True, fastmath=FAST, parallel=True)
def propagate(
    stereo: Stereo,
    reaches: np.ndarray,
    deltas: np.ndarray,
    smoothness: np.float32,
    colour: int,
    still: np.ndarray,
    inverse_depth: np.ndarray,
    cost: np.ndarray,
) -> None:
    """One half-sweep: each pixel of a colour tries its neighbours' planes, then small steps.

    A patch is gathered only where there is something to try.

    Args:
        stereo: the views.
        reaches: (r,) odd distances at which neighbours are tried, px.
        deltas: (d,) steps tried to both sides, px of disparity.
        smoothness: weight of `roughness` beside the matching cost.
        colour: 0 or 1, the half of the chequerboard that is written.
        still: (h, w) bool, pixels whose cost is known to be least here and higher half a pixel of
            disparity to both sides: they try nothing nearer, unless they take a neighbour's plane.
        inverse_depth, cost: (h, w), improved in place.
    """
    picture = stereo.pictures[stereo.reference]
    slopes, step = stereo.slopes, stereo.step
    height, width = picture.shape[0], picture.shape[1]
    for line in prange(height):
        patch = new_patch(stereo)
        row = np.int64(line)  # see the file's docstring
        for column in range((row + colour) % 2, width, 2):
            if math.isnan(picture[row, column, 0]):
                continue
            a, b = slopes[row, column, 0], slopes[row, column, 1]
            best_w, best_data = inverse_depth[row, column], cost[row, column]
            best, count, floor, idle = best_data, -1, ZERO, still[row, column]
            neighbours = 4 * reaches.shape[0]
            for index in range(neighbours + 2 * deltas.shape[0]):
                if index < neighbours:
                    dx, dy = _side(index % 4, reaches[index // 4])
                    x, y = column + dx, row + dy
                    if not (0 <= x < width and 0 <= y < height):
                        continue
                    bend = slopes[y, x, 0] * np.float32(dx) + slopes[y, x, 1] * np.float32(dy)
                    w = inverse_depth[y, x] * (ONE - bend)
                    if not abs(w - best_w) > (HALF if idle else SAME) * step:
                        continue
                else:
                    if idle or not best_w > ZERO:
                        continue
                    delta = deltas[(index - neighbours) // 2] * step
                    w = best_w + delta if index % 2 == 0 else best_w - delta
                if not w > ZERO:
                    continue
                if count < 0:
                    count, floor = gather_patch(stereo, row, column, patch)
                    if best_w > ZERO:
                        best += smoothness * roughness(stereo, inverse_depth, row, column, best_w)
                # The smoothness term alone may already be too dear.
                extra = smoothness * roughness(stereo, inverse_depth, row, column, w)
                if not extra < best:
                    continue
                found = plane_cost(stereo, row, column, (w, a, b), patch, count, floor)
                if found + extra < best:
                    best, best_data, best_w, idle = found + extra, found, w, False
            inverse_depth[row, column] = best_w
            cost[row, column] = best_data


@njit(cache=True, fastmath=FAST, parallel=True)
def polish(
    stereo: Stereo,
    delta: np.float32,
    every: int,
    inverse_depth: np.ndarray,
    cost: np.ndarray,
    out: np.ndarray,
    still: np.ndarray,
    still_share: np.float32,
) -> None:
    """Move each pixel to the minimum of the parabola through its costs at -delta, 0 and +delta.

    Args:
        stereo: the views.
        delta: in inverse depth; a pixel moves by at most half of it.
        every: 1 for all pixels, 2 for every second one of every second row.
        inverse_depth: (h, w), 0 where there is none.
        cost: (h, w), filled with the matching cost before the move.
        out: (h, w) inverse depth, filled.
        still: (h, w) bool, filled: there was a minimum, and no farther than a share of delta.
        still_share: that share.
    """
    height, width = inverse_depth.shape
    for line in prange((height + every - 1) // every):
        patch = new_patch(stereo)
        row = line * every
        for column in range(0, width, every):
            w = inverse_depth[row, column]
            out[row, column] = w
            still[row, column] = False
            cost[row, column] = NO_MATCH
            if not w > ZERO:
                continue
            count, floor = gather_patch(stereo, row, column, patch)
            a, b = stereo.slopes[row, column, 0], stereo.slopes[row, column, 1]
            before = plane_cost(stereo, row, column, (w - delta, a, b), patch, count, floor)
            here = plane_cost(stereo, row, column, (w, a, b), patch, count, floor)
            after = plane_cost(stereo, row, column, (w + delta, a, b), patch, count, floor)
            cost[row, column] = here
            curvature = before - here - here + after
            if curvature > np.float32(1e-6) and max(before, here, after) < NO_MATCH:
                move = HALF * (before - after) / curvature
                out[row, column] = w + delta * min(max(move, -HALF), HALF)
                still[row, column] = abs(move) < still_share


@njit(cache=True, fastmath=FAST, parallel=True)
def search(
    stereo: Stereo,
    steps: np.ndarray,
    every: int,
    wanted: np.ndarray,
    inverse_depth: np.ndarray,
) -> None:
    """Move wanted pixels by that step which fits best, if it fits better than none.

    Args:
        stereo: the views.
        steps: (n,) in inverse depth, the nearest to 0 first.
        every: 1 for all pixels, 2 for every second one of every second row.
        wanted: (h / every, w / every) bool.
        inverse_depth: (h, w), 0 where there is none; changed in place.
    """
    for line in prange(wanted.shape[0]):
        patch = new_patch(stereo)
        row = line * every
        for place in range(wanted.shape[1]):
            column = place * every
            w = inverse_depth[row, column]
            if not (wanted[line, place] and w > ZERO):
                continue
            count, floor = gather_patch(stereo, row, column, patch)
            a, b = stereo.slopes[row, column, 0], stereo.slopes[row, column, 1]
            best = plane_cost(stereo, row, column, (w, a, b), patch, count, floor)
            for index in range(steps.shape[0]):
                moved = w + steps[index]
                if moved > ZERO:
                    cost = plane_cost(stereo, row, column, (moved, a, b), patch, count, floor)
                    if cost < best:
                        best = cost
                        inverse_depth[row, column] = moved
