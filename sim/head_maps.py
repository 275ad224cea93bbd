"""Vertex values of the head spread over its UV tile."""

from __future__ import annotations

import cv2
import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
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
    return to_window(values, rows, columns, 0, rows)


def to_window(values: np.ndarray, rows: int, columns: int, first: int, last: int) -> np.ndarray:
    """Rows `first` to `last` of `to_tile`; rows beyond the tile repeat its edge."""
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


def tile_rows_columns(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Where texel centres lie on the vertex grid: (rows,) rows and (columns,) columns of it."""
    u, v = texel_uv(rows, columns)
    return (1 - v) * ROWS, u * COLUMNS


def surface_normals(mesh: Mesh, height_mm: np.ndarray) -> np.ndarray:
    """Normals of the mesh with a relief on it.

    Args:
        mesh: of the head's topology.
        height_mm: (rows, columns), along the mesh's smooth normals.

    Returns:
        (rows, columns, 3) float32, unit, in the mesh's axes.
    """
    rows, columns = height_mm.shape
    normal = to_tile(vertex_normals(mesh.vertices, mesh.triangles()), rows, columns)
    position = to_tile(mesh.vertices, rows, columns)
    along_row, along_column = _slopes(position)
    height_row, height_column = _slopes(height_mm)
    # Surface gradient of the height from its slopes along two tangents.
    area = np.cross(along_column, along_row)
    size = np.einsum("ijk,ijk->ij", area, normal)
    safe = np.where(np.abs(size) > 1e-9, size, np.inf)
    slope = height_column[..., None] * np.cross(along_row, normal) * -1
    slope += height_row[..., None] * np.cross(along_column, normal)
    bent = normal + slope / safe[..., None]
    length = np.linalg.norm(bent, axis=-1, keepdims=True)
    return (bent / np.maximum(length, 1e-12)).astype(np.float32)


def _slopes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences a texel, down the rows and along the columns."""
    return np.gradient(values, axis=0), np.gradient(values, axis=1)
