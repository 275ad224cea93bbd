"""Loop subdivision that carries UV along, so that a coarse scan shows no facets."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh


def loop_subdivide(mesh: Mesh) -> Mesh:
    """One step of Loop's subdivision [Loop1987]: four triangles for one.

    Vertices move to Loop's smooth positions (an open border stays where it is); UV are split
    linearly on their own topology, so that seams stay seams.

    Args:
        mesh: triangles or quads, with UV or without.

    Returns:
        A triangle mesh; triangles 4 i .. 4 i + 3 replace triangle i.
    """
    triangles = mesh.triangles()
    edges, of_triangle = _edges(triangles)
    count = len(mesh.vertices)
    ends = mesh.vertices[edges]
    shared = np.bincount(of_triangle.ravel(), minlength=len(edges))
    inner = shared == 2
    # The corner opposite to the edge from corner k to k + 1 is corner k + 2.
    opposite = np.zeros((len(edges), 3))
    for corner in range(3):
        np.add.at(opposite, of_triangle[:, corner], mesh.vertices[triangles[:, (corner + 2) % 3]])
    middle = np.where(
        inner[:, None], 0.375 * ends.sum(axis=1) + 0.125 * opposite, 0.5 * ends.sum(axis=1)
    )
    valence = np.bincount(edges.ravel(), minlength=count)
    around = np.zeros((count, 3))
    np.add.at(around, edges[:, 0], mesh.vertices[edges[:, 1]])
    np.add.at(around, edges[:, 1], mesh.vertices[edges[:, 0]])
    safe = np.maximum(valence, 1)
    beta = (0.625 - (0.375 + 0.25 * np.cos(2 * np.pi / safe)) ** 2) / safe
    moved = mesh.vertices * (1 - beta * valence)[:, None] + around * beta[:, None]
    border = np.zeros(count, bool)
    border[edges[~inner].ravel()] = True
    moved[border] = mesh.vertices[border]
    uvs, face_uvs = None, None
    if mesh.uvs is not None:
        uv_triangles = mesh.triangle_uvs()
        uv_edges, uv_of_triangle = _edges(uv_triangles)
        uvs = np.concatenate([mesh.uvs, mesh.uvs[uv_edges].mean(axis=1)])
        face_uvs = _quarter(uv_triangles, uv_of_triangle + len(mesh.uvs))
    return Mesh(
        np.concatenate([moved, middle]), _quarter(triangles, of_triangle + count), uvs, face_uvs
    )


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(e, 2) edges and, for each triangle, the edges that start at its corners."""
    pairs = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1)
    edges, inverse = np.unique(np.sort(pairs.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    return edges, inverse.reshape(-1, 3)


def _quarter(triangles: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Corner triangles and the middle one."""
    a, b, c = triangles.T
    ab, bc, ca = middles.T
    four = np.stack(
        [
            np.stack([a, ab, ca], axis=1),
            np.stack([b, bc, ab], axis=1),
            np.stack([c, ca, bc], axis=1),
            np.stack([ab, bc, ca], axis=1),
        ],
        axis=1,
    )
    return four.reshape(-1, 3).astype(np.int32)
