"""The fused mesh made finer: split, fitted to the points again, and lifted to their normals.

Points are half a millimetre apart, the fused surface's vertices more than one: relief of two or
three millimetres, which the points' normals have, is lost between them. After [Nehab2005], on the
mesh: positions stay near the points' mean, and the steps along edges follow the points' normals.
"""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh, directed_edges, vertex_normals
from processing.displacement import curved_middles, heights_of_steps
from processing.reconstruction.settle import facing, settled
from processing.splitting import split

FACING = 0.75
"""Sigma of the mean of normals, beside that of positions: they are the less noisy."""
STEEPEST = 0.5
"""A step of more than this share of its edge is none of one surface's."""
TOLERANCE = 1e-3
"""Residual at which the solver ends: its heights are then right to .1 micrometres."""
LINKS = 1.5
"""What six edges at a vertex weigh beside the four of a grid of squares."""
SMALL = 0.3
"""Share of the points' relief below which the mesh follows normals, as the points did already."""


def finer(
    mesh: Mesh,
    positions: np.ndarray,
    normals: np.ndarray,
    splits: int,
    sigma_mm: float,
    relief_mm: float,
) -> Mesh:
    """Split a mesh, move it onto oriented points, and give it the relief of their normals.

    Args:
        mesh: triangles, mm, world, within a millimetre of the points.
        positions, normals: (n, 3) oriented points.
        splits: how often triangles are split in four; 0 leaves the mesh as it is.
        sigma_mm: of the Gaussian under which points are averaged.
        relief_mm: shapes smaller than this come from the normals; 0 for none.
    """
    if splits < 1 or not len(positions):
        return mesh
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int64)
    for _ in range(splits):
        own = vertex_normals(vertices, faces)
        faces, ends = split(faces, len(vertices))
        vertices = np.concatenate([vertices, curved_middles(vertices, own, ends)])
    fine = Mesh(vertices, faces.astype(np.int32))
    fine = settled(fine, positions, normals, sigma_mm, rounds=1)
    if not relief_mm > 0 or not sigma_mm > 0:
        return fine
    return lifted(fine, *facing(fine, positions, normals, FACING * sigma_mm), relief_mm)


def lifted(mesh: Mesh, wanted: np.ndarray, known: np.ndarray, relief_mm: float) -> Mesh:
    """Move vertices along their normals so that their normals become the ones wanted.

    Args:
        mesh: triangles of one orientation, mm.
        wanted: (v, 3) unit normals.
        known: (v,) bool; edges count where both ends are.
        relief_mm: of the points; shapes smaller than SMALL of it come from the normals here.
    """
    vertices = np.asarray(mesh.vertices, float)
    edges = directed_edges(mesh.faces)
    # Two triangles have an edge, one each way; of the outline's edges half are enough.
    edges = edges[(edges[:, 0] < edges[:, 1]) & known[edges].all(axis=1)]
    if not len(edges):
        return mesh
    own = vertex_normals(vertices, mesh.faces)
    along = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    length = np.linalg.norm(along, axis=1)
    # Beyond the vertices' own: both are means over what is around a vertex, and equally smooth.
    turn = wanted - own
    steps = -0.5 * np.einsum("ek,ek->e", turn[edges[:, 0]] + turn[edges[:, 1]], along)
    kept = np.abs(steps) < STEEPEST * length
    weight = LINKS * (float(length.mean()) / (SMALL * relief_mm)) ** 2
    height = heights_of_steps(len(vertices), edges[kept], steps[kept], weight, TOLERANCE)
    return Mesh(vertices + height[:, None] * own, mesh.faces)
