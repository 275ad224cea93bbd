"""Which shadow rays must be cast, and the bits that keep their answers."""

from __future__ import annotations

import numba
import numpy as np

SAME_SURFACE_MM = 4.0
"""Coarse neighbours whose depths differ by more are not taken for one surface."""


@numba.njit(cache=True, inline="always")
def _faces(position: np.ndarray, normal: np.ndarray, light: np.ndarray) -> bool:
    """Whether a light is above a point's horizon."""
    x, y, z = light[0] - position[0], light[1] - position[1], light[2] - position[2]
    return x * normal[0] + y * normal[1] + z * normal[2] > 0.0


@numba.njit(cache=True, parallel=True)
def mark_coarse(
    position: np.ndarray,
    normal: np.ndarray,
    lights: np.ndarray,
    coarse: np.ndarray,
    todo: np.ndarray,
) -> None:
    """Set in `todo` (n, m) the lights above the horizon of each chosen point."""
    for i in numba.prange(len(position)):
        for k in range(len(lights)):
            todo[i, k] = coarse[i] and _faces(position[i], normal[i], lights[k])


@numba.njit(cache=True)
def set_bits(bits: np.ndarray, points: np.ndarray, lights: np.ndarray) -> None:
    """Set, in (n, ceil(m / 8)) bits, those of k pairs of point and light, (k,) each."""
    for i in range(len(points)):
        bits[points[i], lights[i] >> 3] |= np.uint8(1 << (lights[i] & 7))


@numba.njit(cache=True, parallel=True)
def fill_between(
    position: np.ndarray,
    normal: np.ndarray,
    lights: np.ndarray,
    index: np.ndarray,
    pixel: np.ndarray,
    depth: np.ndarray,
    step: int,
    first: int,
    bits: np.ndarray,
    todo: np.ndarray,
) -> None:
    """Take the coarse neighbours' answer where they agree, mark the other pairs in `todo`.

    Works on a tile of t entries at a time; all coarse pixels must have their answer.

    Args:
        position: (n, 3) float32.
        normal: (n, 3) float32.
        lights: (m, 3) float32.
        index: (h, w) int64, each pixel's entry or -1.
        pixel: (n,) each entry's pixel, in row order.
        depth: (n,) float32 mm from the camera.
        step: of the coarse grid, px.
        first: entry of the tile.
        bits: (n, ceil(m / 8)) uint8, set for the coarse pixels; filled in.
        todo: (t, m) bool, filled in.
    """
    height, width = index.shape
    for j in numba.prange(len(todo)):
        i = np.int64(first + j)
        for k in range(len(lights)):
            todo[j, k] = False
        row, column = pixel[i] // width, pixel[i] % width
        top, left = row - row % step, column - column % step
        if row == top and column == left:
            continue
        bottom, right = top + step, left + step
        whole = bottom < height and right < width
        a = b = c = d = i
        if whole:
            a, b = index[top, left], index[top, right]
            c, d = index[bottom, left], index[bottom, right]
            whole = min(min(a, b), min(c, d)) >= 0
        if whole:
            near = min(min(depth[a], depth[b]), min(depth[c], depth[d]))
            far = max(max(depth[a], depth[b]), max(depth[c], depth[d]))
            whole = max(far, depth[i]) - min(near, depth[i]) < SAME_SURFACE_MM
        for k in range(len(lights)):
            if not _faces(position[i], normal[i], lights[k]):
                continue
            if whole:
                byte, bit = k >> 3, k & 7
                seen = (
                    ((bits[a, byte] >> bit) & 1)
                    + ((bits[b, byte] >> bit) & 1)
                    + ((bits[c, byte] >> bit) & 1)
                    + ((bits[d, byte] >> bit) & 1)
                )
                if seen == 4:
                    bits[i, byte] |= np.uint8(1 << bit)
                    continue
                # Dark at all four counts only where each really cast a ray.
                if (
                    seen == 0
                    and _faces(position[a], normal[a], lights[k])
                    and _faces(position[b], normal[b], lights[k])
                    and _faces(position[c], normal[c], lights[k])
                    and _faces(position[d], normal[d], lights[k])
                ):
                    continue
            todo[j, k] = True
