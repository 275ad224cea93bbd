"""Vertex values of the head spread over its UV tile."""

from __future__ import annotations

import cv2
import numpy as np

from lightstage.formats.processed import texel_uv
from sim.head_grid import COLUMNS, ROWS
from sim.head_mesh import grid_vertices, regions


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
    grid = np.asarray(values)[grid_vertices()].astype(np.float32)
    u, v = texel_uv(rows, columns)
    x, y = np.meshgrid((u * COLUMNS).astype(np.float32), ((1 - v) * ROWS).astype(np.float32))
    return cv2.remap(grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def region_map(name: str, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) float32 membership 0..1 of a region, a linear step one cell wide."""
    count = int(grid_vertices().max()) + 1
    inside = np.zeros(count, np.float32)
    inside[regions()[name]] = 1.0
    return to_tile(inside, rows, columns)
