"""Normals of a surface with a relief on it, in any UV."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, parallel=True)
def _bend(
    position: np.ndarray,
    normal: np.ndarray,
    height: np.ndarray,
    covered: np.ndarray,
    reach2: float,
    out: np.ndarray,
) -> None:
    """Fill `out` (h, w, 3) with bent normals; arguments as `bend_normals`."""
    rows, columns = height.shape
    for line in numba.prange(rows):
        # The loop's own index is unsigned: less one it would be a float.
        r = np.intp(line)
        slope = np.zeros(2)
        tangent = np.zeros((2, 3))
        for c in range(columns):
            nx, ny, nz = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if not covered[r, c] or not 1e-9 < length < 1e9:
                out[r, c] = 0.0
                continue
            nx, ny, nz = nx / length, ny / length, nz / length
            for axis in range(2):
                back_r, back_c, next_r, next_c = r, c, r, c
                if axis == 0:
                    back_c, next_c = max(c - 1, 0), min(c + 1, columns - 1)
                else:
                    back_r = r - 1 if r > 0 else r
                    next_r = r + 1 if r + 1 < rows else r
                if not _joined(position, covered, r, c, back_r, back_c, reach2):
                    back_r, back_c = r, c
                if not _joined(position, covered, r, c, next_r, next_c, reach2):
                    next_r, next_c = r, c
                slope[axis] = height[next_r, next_c] - height[back_r, back_c]
                for k in range(3):
                    tangent[axis, k] = position[next_r, next_c, k] - position[back_r, back_c, k]
            ux, uy, uz = tangent[0, 0], tangent[0, 1], tangent[0, 2]
            vx, vy, vz = tangent[1, 0], tangent[1, 1], tangent[1, 2]
            # u x n and v x n, and the area they span as seen along n.
            un = (uy * nz - uz * ny, uz * nx - ux * nz, ux * ny - uy * nx)
            vn = (vy * nz - vz * ny, vz * nx - vx * nz, vx * ny - vy * nx)
            size = ux * vn[0] + uy * vn[1] + uz * vn[2]
            bx, by, bz = nx, ny, nz
            if abs(size) > 1e-12:
                a, b = slope[0] / size, slope[1] / size
                bx += b * un[0] - a * vn[0]
                by += b * un[1] - a * vn[1]
                bz += b * un[2] - a * vn[2]
            bent = np.sqrt(bx * bx + by * by + bz * bz)
            if not bent < 1e6:
                bx, by, bz, bent = nx, ny, nz, 1.0
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = bx / bent, by / bent, bz / bent


@numba.njit(cache=True, inline="always")
def _joined(
    position: np.ndarray, covered: np.ndarray, r: int, c: int, s: int, d: int, reach2: float
) -> bool:
    """Whether a neighbouring texel is on the same piece of the surface."""
    if not covered[s, d]:
        return False
    away = 0.0
    for k in range(3):
        step = position[s, d, k] - position[r, c, k]
        away += step * step
    return away <= reach2


def bend_normals(
    position_mm: np.ndarray,
    normal: np.ndarray,
    height_mm: np.ndarray,
    covered: np.ndarray | None = None,
    reach_mm: float = np.inf,
) -> np.ndarray:
    """Normals of a surface with a relief on it, in any UV.

    Args:
        position_mm: (rows, columns, 3) of the texels on the smooth (posed) surface.
        normal: (rows, columns, 3) its smooth normals; need not be unit.
        height_mm: (rows, columns) along them.
        covered: (rows, columns) bool, texels on the surface; None for all.
        reach_mm: texels farther from each other than this are no neighbours (a seam between
            charts lies between them).

    Returns:
        (rows, columns, 3) float32, unit; zero where nothing is covered or no normal is. Where the
        slope is not finite or the texels span no area the smooth normal stays.
    """
    mask = np.ones(height_mm.shape, bool) if covered is None else np.asarray(covered, bool)
    out = np.empty((*height_mm.shape, 3), np.float32)
    fields = (np.ascontiguousarray(a, np.float32) for a in (position_mm, normal, height_mm))
    _bend(*fields, mask, float(reach_mm) ** 2, out)
    return out
