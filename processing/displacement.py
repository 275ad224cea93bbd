"""Split meshes displaced: middles without facets, and heights from their steps."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

TOLERANCE, MOST_STEPS = 1e-7, 400
"""End of the conjugate gradients: share of the first residual that may be left, and steps."""


def curved_middles(vertices: np.ndarray, normals: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(m, 3) middles of edges (m, 2), on the cubic curves that are square to the ends' normals.

    Straight middles would leave the mesh's facets in the fine one.
    """
    along = vertices[ends[:, 1]] - vertices[ends[:, 0]]
    first, second = normals[ends[:, 0]], normals[ends[:, 1]]
    rise = np.einsum("mk,mk->m", along, second)[:, None] * second
    rise -= np.einsum("mk,mk->m", along, first)[:, None] * first
    return np.asarray(vertices[ends].mean(axis=1) + rise / 8)


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
