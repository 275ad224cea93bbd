"""A mesh of more triangles, moved along its normals by a map of heights."""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.errors import MapsError
from learning.render.view import sample_bilinear
from lightstage.formats.mesh import Mesh, vertex_normals

MOST_TRIANGLES = 8_000_000


def embossed(mesh: Mesh, height_mm: np.ndarray, times: int) -> Mesh:
    """Split each triangle into four, so many times, and move the vertices by their heights.

    Args:
        mesh: with UV; quads become triangles.
        height_mm: (rows, columns), in the mesh's texture.
        times: 0 or more.

    Returns:
        The mesh with its UV. A vertex on a seam has the mean of what its sides say, so that the
        surface stays closed.

    Raises:
        MapsError: a mesh without UV, or more triangles than `MOST_TRIANGLES`.
    """
    if mesh.uvs is None:
        raise MapsError("mesh", field="uv", found="none", expected="texture coordinates")
    triangles, corners = mesh.triangles(), mesh.triangle_uvs()
    if len(triangles) * 4**times > MOST_TRIANGLES:
        raise MapsError(
            "--subdivide",
            found=f"{times}, {len(triangles) * 4**times:,} triangles",
            expected=f"at most {MOST_TRIANGLES:,}",
        )
    vertices, uvs = mesh.vertices.astype(float), mesh.uvs.astype(float)
    normals = vertex_normals(vertices, triangles)
    for _ in range(times):
        values, split = _split(np.column_stack([vertices, normals]), triangles)
        uvs, corners = _split(uvs, corners)
        vertices, normals, triangles = values[:, :3], values[:, 3:], split
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 1e-12)
    said = sample_bilinear(np.asarray(height_mm, float)[..., None], uvs)[:, 0]
    total, count = np.zeros(len(vertices)), np.zeros(len(vertices))
    np.add.at(total, triangles.ravel(), said[corners.ravel()])
    np.add.at(count, triangles.ravel(), 1.0)
    moved = vertices + (total / np.maximum(count, 1))[:, None] * normals
    return dataclasses.replace(
        mesh,
        vertices=moved,
        faces=triangles.astype(np.int32),
        uvs=uvs,
        face_uvs=corners.astype(np.int32),
    )


def _split(values: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values with those of the edges' middles behind them, and four triangles for each."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, which = np.unique(edges, axis=0, return_inverse=True)
    middle = len(values) + which.reshape(-1, 3)
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    four = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(2, 0, 1)
    return np.concatenate([values, values[unique].mean(axis=1)]), four.reshape(-1, 3)
