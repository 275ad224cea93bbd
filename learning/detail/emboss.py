"""A mesh of more triangles, rounded by its normals and moved along them by a map of heights."""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.errors import MapsError
from learning.render.view import sample_bilinear
from learning.vectors import unit
from lightstage.formats.mesh import Mesh, vertex_normals

MOST_TRIANGLES = 8_000_000
ROUND = 0.75
"""Part of the way from an edge's middle to the planes of its ends' normals [Boubekeur2008]."""


def embossed(mesh: Mesh, height_mm: np.ndarray, times: int) -> Mesh:
    """Split each triangle into four, so many times, and move the vertices by their heights.

    Args:
        mesh: with UV; quads become triangles.
        height_mm: (rows, columns), in the mesh's texture.
        times: 0 or more.

    Returns:
        The mesh with its UV. A vertex on a seam has the mean of the heights on its sides, so that
        the surface stays closed.

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
        split, edges = _split(len(vertices), triangles)
        middle = _rounded(vertices[edges], normals[edges])
        vertices = np.concatenate([vertices, middle])
        normals = np.concatenate([normals, unit(normals[edges].mean(axis=1))])
        corners, edges = _split(len(uvs), corners)
        uvs = np.concatenate([uvs, uvs[edges].mean(axis=1)])
        triangles = split
    sampled = sample_bilinear(np.asarray(height_mm, float)[..., None], uvs)[:, 0]
    total, count = np.zeros(len(vertices)), np.zeros(len(vertices))
    np.add.at(total, triangles.ravel(), sampled[corners.ravel()])
    np.add.at(count, triangles.ravel(), 1.0)
    moved = vertices + (total / np.maximum(count, 1))[:, None] * normals
    return dataclasses.replace(
        mesh,
        vertices=moved,
        faces=triangles.astype(np.int32),
        uvs=uvs,
        face_uvs=corners.astype(np.int32),
    )


def _split(count: int, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Four triangles for each, and the (e, 2) edges whose middles come behind `count` values."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, which = np.unique(edges, axis=0, return_inverse=True)
    middle = count + which.reshape(-1, 3)
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    four = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(2, 0, 1)
    return four.reshape(-1, 3), unique


def _rounded(ends: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(e, 3) middles of edges, brought toward the planes of their ends' normals.

    Without it the triangles of the mesh show as flat facets under its heights.

    Args:
        ends: (e, 2, 3) places.
        normals: (e, 2, 3) unit, or zero where there is none.
    """
    middle = ends.mean(axis=1)
    off = ((middle[:, None] - ends) * normals).sum(axis=2, keepdims=True)
    found: np.ndarray = middle - ROUND * (off * normals).mean(axis=1)
    return found
