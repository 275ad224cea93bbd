"""Vertex values of the head spread over its UV tile."""

from __future__ import annotations

import functools

import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.head.grid import COLUMNS, ROWS
from sim.head.mesh import grid_places, grid_vertices, neutral_mesh, regions, row_and_column
from sim.light.texture import raster_rows, sample
from sim.skin.normals import bend_normals

NORMAL_STRIP_TEXELS = 1 << 20


def over_grid(values: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Bilinear interpolation of vertex values on a picture over which the grid is spread evenly.

    Args:
        values: (n,) or (n, c), a value a vertex.
        rows: of the picture.
        columns: of the picture.

    Returns:
        (rows, columns) or (rows, columns, c) float32.
    """
    row, column = (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns
    x, y = np.meshgrid((column * COLUMNS).astype(np.float32), (row * ROWS).astype(np.float32))
    return at_grid(values, y, x)


def at_grid(values: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Bilinear interpolation of vertex values (n[, c]) at places of the grid: (h, w[, c]).

    OpenCV's `remap` rounds places to 1/32 of a cell, and large textures have more texels in one.
    """
    grid = np.asarray(values)[grid_vertices()]
    across = (column.astype(np.float64) + 0.5) / (COLUMNS + 1)
    up = 1 - (row.astype(np.float64) + 0.5) / (ROWS + 1)
    found = sample(grid, np.stack([across, up], axis=-1).reshape(-1, 2))
    return found.reshape(*row.shape, *grid.shape[2:])


def to_tile(values: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Interpolation of vertex values at the tile's texel centres.

    Within a quad this differs from the two triangles by less than the quad's warp.

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
    return at_grid(values, *grid_window(rows, columns, first, last))


@functools.lru_cache(maxsize=2)
def grid_window(rows: int, columns: int, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the vertex grid at texels of rows `first` to `last` of the tile.

    Args:
        rows: of the tile.
        columns: of the tile.
        first: row.
        last: row, not among them.

    Returns:
        (last - first, columns) float32 each; rows beyond the tile repeat its edge.
    """
    low, high = max(first, 0), min(last, rows)
    mesh = neutral_mesh()
    corners = mesh.triangle_uvs()
    face, weights = raster_rows(mesh, rows, columns, low, high)
    here = grid_places()[corners[face]]
    # The tile is full: a texel's centre is on a triangle, or on an edge but for rounding.
    place = np.einsum("hwk,hwkc->hwc", weights, here)
    beyond = ((low - first, last - high), (0, 0))
    row, column = (np.pad(image, beyond, mode="edge") for image in row_and_column(place))
    row.flags.writeable = column.flags.writeable = False
    return row, column


def region_share(name: str) -> np.ndarray:
    """(n,) float32 1 for the vertices of a region: in between a linear step one cell wide."""
    inside = np.zeros(int(grid_vertices().max()) + 1, np.float32)
    inside[regions()[name]] = 1.0
    return inside


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
