"""Meshes that are split and displaced: middles without facets, and heights from their steps."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from lightstage.formats.mesh import Mesh

TOLERANCE, MOST_STEPS = 1e-7, 400
"""Of the conjugate gradients: share of the first residual that may be left, and steps."""


def curved_middles(vertices: np.ndarray, normals: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(m, 3) middles of edges (m, 2), on the cubic curves that are square to the ends' normals.

    Straight middles would leave the mesh's facets in the fine one.
    """
    along = vertices[ends[:, 1]] - vertices[ends[:, 0]]
    first, second = normals[ends[:, 0]], normals[ends[:, 1]]
    rise = np.einsum("mk,mk->m", along, second)[:, None] * second
    rise -= np.einsum("mk,mk->m", along, first)[:, None] * first
    return np.asarray(vertices[ends].mean(axis=1) + rise / 8)


def unsplit(mesh: Mesh, least: int = 1) -> Mesh:
    """The mesh before it was split (`surface.split`); as it is where it never was.

    Args:
        mesh: triangles, in the order in which `surface.split` leaves them.
        least: triangles that are left, at least.
    """
    triangles = mesh.triangles()
    while len(triangles) % 4 == 0 and len(triangles) >= 4 * least:
        corner, second, third, between = triangles.reshape(-1, 4, 3).transpose(1, 0, 2)
        coarse = np.stack([corner[:, 0], second[:, 1], third[:, 2]], axis=1)
        count = int(coarse.max()) + 1
        ab, bc, ca = between.T
        middles = [corner[:, 1:] == np.stack([ab, ca], axis=1)]
        middles += [second[:, [0, 2]] == np.stack([ab, bc], axis=1)]
        middles += [third[:, :2] == np.stack([ca, bc], axis=1), between >= count]
        if not all(same.all() for same in middles):
            break
        triangles = coarse
    if len(triangles) == len(mesh.triangles()):
        return mesh
    return Mesh(mesh.vertices[: int(triangles.max()) + 1], np.ascontiguousarray(triangles))


def heights_of_steps(
    count: int,
    edges: np.ndarray,
    steps: np.ndarray,
    weight: float,
    tolerance: float = TOLERANCE,
) -> np.ndarray:
    """The height h with sum over edges (h' - h - step)^2 + weight * sum h^2 least.

    Conjugate gradients, scaled by the matrix's diagonal.

    Args:
        count: of vertices, v.
        edges: (e, 2).
        steps: (e,) wanted, mm.
        weight: of staying, above 0.
        tolerance: share of the first residual that may be left.

    Returns:
        (v,) mm.
    """
    first, second = edges.T
    right = np.bincount(second, steps, count) - np.bincount(first, steps, count)
    rows = np.concatenate([first, second])
    columns = np.concatenate([second, first])
    links = sparse.coo_array((np.ones(len(rows)), (rows, columns)), (count, count)).tocsr()
    diagonal = np.bincount(rows, minlength=count) + weight
    matrix = sparse.diags_array(diagonal) - links
    scaled = sparse.diags_array(1 / diagonal)
    height, _ = cg(matrix, right, rtol=tolerance, maxiter=MOST_STEPS, M=scaled)
    return np.asarray(height)
