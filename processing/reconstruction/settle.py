"""Vertices of the fused mesh onto the points: the Poisson surface rounds what is near its cells.

An implicit surface of oriented points [Kolluri2008], but along the mean of the vertex's normal and
the point's: a plane through either one alone misses a bent surface by half its sagitta, to one side
or the other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from lightstage.formats.mesh import Mesh, vertex_normals

ROUNDS = 2
REACH = 3.0
"""Points farther than so many sigma do not count, nor those a sigma and a half off the tangent."""
OFF = 1.5
TURNED = 0.5
"""Least cosine between a point's normal and the vertex's."""
LEAST = 0.5
"""Weight of all points below which a vertex stays."""
SHORT = 0.9
"""Normals whose mean is shorter than this contradict each other."""
MOST_CELLS = 2**24


class Cells(NamedTuple):
    """Oriented points, sorted by the cells of a grid.

    Attributes:
        points, facing: (n, 3) float64, cell by cell.
        starts: (cells + 1,) index of each cell's first point.
        origin: (3,) mm.
        size: of a cell, mm.
        shape: (3,) cells along each axis.
    """

    points: np.ndarray
    facing: np.ndarray
    starts: np.ndarray
    origin: np.ndarray
    size: float
    shape: np.ndarray


def settled(
    mesh: Mesh,
    positions: np.ndarray,
    normals: np.ndarray,
    sigma_mm: float,
    rounds: int = ROUNDS,
) -> Mesh:
    """Move each vertex along its normal onto the weighted mean of the points around it.

    Args:
        mesh: within a millimetre of the points.
        positions, normals: (n, 3) oriented points.
        sigma_mm: of the Gaussian weights; 0 leaves the mesh as it is.
        rounds: one is enough from within a few hundredths of a millimetre.

    Returns:
        The mesh; vertices without points near stay.
    """
    if not sigma_mm > 0 or not len(positions):
        return mesh
    vertices = np.ascontiguousarray(mesh.vertices, np.float64)
    cells = _in_cells(vertices, positions, normals, math.hypot(REACH, OFF) * sigma_mm)
    for _ in range(rounds):
        own = np.ascontiguousarray(vertex_normals(vertices, mesh.faces), np.float64)
        total, shift = _sums(vertices, own, cells, sigma_mm)[:, :2].T
        some = total > LEAST
        height = np.divide(shift, total, out=np.zeros_like(shift), where=some)
        vertices = vertices + height[:, None] * own
    return Mesh(vertices, mesh.faces)


def facing(
    mesh: Mesh, positions: np.ndarray, normals: np.ndarray, sigma_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which way the points around each vertex face: the weighted mean of their normals.

    Args:
        mesh: within a millimetre of the points.
        positions, normals: (n, 3) oriented points.
        sigma_mm: of the Gaussian weights, above 0.

    Returns:
        (v, 3) unit normals, the mesh's own where no points are near or their mean is short; (v,)
        bool, where it is theirs.
    """
    vertices = np.ascontiguousarray(mesh.vertices, np.float64)
    own = np.ascontiguousarray(vertex_normals(vertices, mesh.faces), np.float64)
    cells = _in_cells(vertices, positions, normals, math.hypot(REACH, OFF) * sigma_mm)
    sums = _sums(vertices, own, cells, sigma_mm)
    total, mean = sums[:, 0], sums[:, 2:]
    length = np.linalg.norm(mean, axis=1)
    known = (total > LEAST) & (length > SHORT * total)
    return np.where(known[:, None], mean / np.maximum(length, 1e-9)[:, None], own), known


def _in_cells(
    vertices: np.ndarray, positions: np.ndarray, normals: np.ndarray, size: float
) -> Cells:
    """Points in cells of a size or larger, as far as the vertices reach; others are left out."""
    origin = vertices.min(axis=0) - 2 * size
    span = vertices.max(axis=0) + 2 * size - origin
    # Far from each other few vertices share a grid of many cells: then cells are larger.
    size = max(size, float((span.prod() / MOST_CELLS) ** (1 / 3)))
    shape = np.ceil(span / size).astype(np.int64) + 1
    place = np.floor((positions - origin) / size)
    inside = ((place >= 0) & (place < shape)).all(axis=1)
    place = place[inside].astype(np.int64)
    key = (place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2]
    order = np.argsort(key, kind="stable")
    starts = np.zeros(shape.prod() + 1, np.int64)
    np.cumsum(np.bincount(key, minlength=shape.prod()), out=starts[1:])
    return Cells(
        np.ascontiguousarray(positions[inside][order], np.float64),
        np.ascontiguousarray(normals[inside][order], np.float64),
        starts,
        origin,
        size,
        shape,
    )


@njit(cache=True, parallel=True)
def _sums(vertices: np.ndarray, own: np.ndarray, cells: Cells, sigma: float) -> np.ndarray:
    """(v, 5) sums over the points around each vertex: of weights, of weighted heights along its
    normal, of weighted normals.
    """
    points, facing, starts, origin, size, shape = cells
    out = np.empty((len(vertices), 5))
    for v in prange(len(vertices)):
        p, n = vertices[v], own[v]
        cx = int((p[0] - origin[0]) / size)
        cy = int((p[1] - origin[1]) / size)
        cz = int((p[2] - origin[2]) / size)
        total = shift = mx = my = mz = 0.0
        # Cells along z are one behind the other: three in one run.
        for x in range(max(cx - 1, 0), min(cx + 2, shape[0])):
            for y in range(max(cy - 1, 0), min(cy + 2, shape[1])):
                line = (x * shape[1] + y) * shape[2]
                first = starts[line + max(cz - 1, 0)]
                last = starts[line + min(cz + 2, shape[2])]
                for i in range(first, last):
                    dx, dy, dz = points[i, 0] - p[0], points[i, 1] - p[1], points[i, 2] - p[2]
                    off = dx * n[0] + dy * n[1] + dz * n[2]
                    across = dx * dx + dy * dy + dz * dz - off * off
                    if not (across < (REACH * sigma) ** 2 and abs(off) < OFF * sigma):
                        continue
                    ax, ay, az = facing[i, 0], facing[i, 1], facing[i, 2]
                    if not ax * n[0] + ay * n[1] + az * n[2] > TURNED:
                        continue
                    weight = math.exp(-0.5 * across / sigma**2)
                    total += weight
                    shift += weight * 0.5 * (off + dx * ax + dy * ay + dz * az)
                    mx, my, mz = mx + weight * ax, my + weight * ay, mz + weight * az
        out[v, 0], out[v, 1] = total, shift
        out[v, 2], out[v, 3], out[v, 4] = mx, my, mz
    return out
