"""Discrete Laplacians of a triangle mesh, which make smooth displacements cheap to solve for."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from lightstage.formats.mesh import connected, directed_edges

LARGEST_COTANGENT = 20.0


def cotangent_laplacian(
    vertices: np.ndarray, triangles: np.ndarray
) -> tuple[sp.csr_matrix, np.ndarray]:
    """Stiffness matrix and lumped areas [Pinkall1993].

    Cotangents are clamped to [0, 20]: obtuse angles would make the matrix indefinite and slivers
    would dominate it.

    Args:
        vertices: (n, 3) mm.
        triangles: (t, 3).

    Returns:
        (n, n) symmetric, positive semidefinite, zero row sums; (n,) mm^2, a third of the area of
        each vertex's triangles.
    """
    count = len(vertices)
    corners = vertices[triangles]
    double_area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    rows, columns, weights = [], [], []
    areas = np.zeros(count)
    for k in range(3):
        a, b, c = triangles[:, k], triangles[:, (k + 1) % 3], triangles[:, (k + 2) % 3]
        dot = np.einsum("tk,tk->t", vertices[b] - vertices[a], vertices[c] - vertices[a])
        ceiling = LARGEST_COTANGENT * double_area
        cotangent = np.where(double_area > 0, np.clip(dot, 0, ceiling), 0)
        half = 0.5 * np.divide(
            cotangent, double_area, out=np.zeros_like(dot), where=double_area > 0
        )
        rows += [b, c]
        columns += [c, b]
        weights += [half, half]
        areas += np.bincount(a, double_area / 6, minlength=count)
    joined = sp.coo_matrix(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))),
        shape=(count, count),
    ).tocsr()
    degree = np.asarray(joined.sum(axis=1)).ravel()
    return (sp.diags(degree) - joined).tocsr(), areas


def tie_components(vertices: np.ndarray, triangles: np.ndarray, strength: float) -> sp.csr_matrix:
    """Springs between each smaller component's vertices and the nearest ones of the largest.

    Eyeballs and the like then move with the skin around them instead of staying behind.

    Args:
        vertices: (n, 3).
        triangles: (t, 3).
        strength: weight of one spring.

    Returns:
        (n, n) symmetric, positive semidefinite; empty for a connected mesh.
    """
    count = len(vertices)
    label = connected(triangles[:, [0, 1, 1, 2]].reshape(-1, 2), count)
    if not label.any():
        return sp.csr_matrix((count, count))
    largest = np.argmax(np.bincount(label))
    loose, body = np.flatnonzero(label != largest), np.flatnonzero(label == largest)
    near = body[cKDTree(vertices[body]).query(vertices[loose])[1]]
    rows = np.concatenate([loose, near, loose, near])
    columns = np.concatenate([loose, near, near, loose])
    values = strength * np.repeat([1.0, 1.0, -1.0, -1.0], len(loose))
    return sp.coo_matrix((values, (rows, columns)), shape=(count, count)).tocsr()


def neighbour_mean(triangles: np.ndarray, count: int) -> sp.csr_matrix:
    """(n, n) matrix that averages each vertex's neighbours."""
    ends = directed_edges(triangles)
    both = np.concatenate([ends, ends[:, ::-1]])
    joined = sp.coo_matrix((np.ones(len(both)), both.T), shape=(count, count)).tocsr()
    joined.data[:] = 1
    degree = np.maximum(np.asarray(joined.sum(axis=1)).ravel(), 1)
    return (sp.diags(1 / degree) @ joined).tocsr()
