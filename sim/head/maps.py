"""Vertex values of the head spread over its UV tile."""

from __future__ import annotations

import cv2
import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.head.grid import COLUMNS, ROWS
from sim.head.mesh import grid_vertices, regions
from sim.skin.normals import bend_normals

NORMAL_STRIP_TEXELS = 1 << 20


def to_tile(values: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Bilinear interpolation of vertex values at the tile's texel centres.

    The tile is the vertex grid itself, so no rasteriser is needed. Within a quad this differs from
    the two triangles by less than the quad's warp.

    Args:
        values: (n,) or (n, c), a value a vertex.
        rows: of the tile.
        columns: of the tile.

    Returns:
        (rows, columns) or (rows, columns, c) float32.
    """
    return to_window(values, rows, columns, 0, rows)


def to_window(values: np.ndarray, rows: int, columns: int, first: int, last: int) -> np.ndarray:
    """Rows `first` to `last` of `to_tile`, of its shapes; rows beyond the tile repeat its edge."""
    grid = np.asarray(values)[grid_vertices()].astype(np.float32)
    row, column = (np.arange(first, last) + 0.5) / rows, (np.arange(columns) + 0.5) / columns
    x, y = np.meshgrid((column * COLUMNS).astype(np.float32), (row * ROWS).astype(np.float32))
    return cv2.remap(grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def region_map(name: str, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) float32 membership 0..1 of a region, a linear step one cell wide."""
    count = int(grid_vertices().max()) + 1
    inside = np.zeros(count, np.float32)
    inside[regions()[name]] = 1.0
    return to_tile(inside, rows, columns)


def surface_normals(mesh: Mesh, height_mm: np.ndarray) -> np.ndarray:
    """Normals of the mesh with a relief on it, strip by strip.

    Args:
        mesh: of the head's topology, posed.
        height_mm: (rows, columns), along the mesh's smooth normals.

    Returns:
        (rows, columns, 3) float32, unit, in the mesh's axes.
    """
    rows, columns = height_mm.shape
    smooth = vertex_normals(mesh.vertices, mesh.triangles())
    out = np.empty((rows, columns, 3), np.float32)
    step = max(8, NORMAL_STRIP_TEXELS // columns)
    for first in range(0, rows, step):
        last = min(first + step, rows)
        # One more row on each side, for the slopes.
        low, high = max(first - 1, 0), min(last + 1, rows)
        position = to_window(mesh.vertices, rows, columns, low, high)
        normal = to_window(smooth, rows, columns, low, high)
        bent = bend_normals(position, normal, height_mm[low:high])
        out[first:last] = bent[first - low : last - low]
    return out
