"""A template of fewer vertices, on which coarse stiffnesses run: they bend nothing it cannot."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import connected, directed_edges
from processing.registration.target import border_vertices


@dataclasses.dataclass(frozen=True)
class Coarse:
    """Some of a mesh's vertices and triangles between them.

    Attributes:
        chosen: (k,) indices of the vertices that stay, each for its patch.
        patch: (n,) which of them represents each vertex.
        triangles: (t, 3) indices into `chosen`.
    """

    chosen: np.ndarray
    patch: np.ndarray
    triangles: np.ndarray


def coarsened(
    vertices: np.ndarray, triangles: np.ndarray, cell_mm: float, kept: np.ndarray
) -> Coarse:
    """Join the vertices of each cube of a grid that edges within it connect.

    What merely is close, such as one lip on the other, is not joined. Each patch is one vertex,
    so the mesh keeps its shape but for what patches hide.

    Args:
        vertices: (n, 3) mm.
        triangles: (t, 3).
        cell_mm: the cubes' side.
        kept: (m,) vertices that are joined with none: two landmarks must not become one.

    Returns:
        Coarse; triangles within one patch, or between two, are removed.
    """
    count = len(vertices)
    cell = np.floor(vertices / cell_mm).astype(np.int64)
    ends = directed_edges(triangles)
    alone = np.zeros(count, bool)
    alone[kept] = True
    same = (cell[ends[:, 0]] == cell[ends[:, 1]]).all(axis=1)
    patch = connected(ends[same & ~alone[ends].any(axis=1)], count)
    number = int(patch.max()) + 1
    size = np.bincount(patch)
    middle = np.stack([np.bincount(patch, axis, number) for axis in vertices.T], axis=1)
    away = np.linalg.norm(vertices - (middle / size[:, None])[patch], axis=1)
    # The mesh's own border stays where it is.
    rank = np.where(border_vertices(triangles, count), 0, 1)
    order = np.lexsort((away, rank, patch))
    chosen = order[np.searchsorted(patch[order], np.arange(number))]
    faces = patch[triangles]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return Coarse(chosen, patch, faces[np.sort(first)].astype(np.int32))
