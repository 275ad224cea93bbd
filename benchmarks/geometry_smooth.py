"""People without facets: shape and shading of one smooth surface, as of a real face.

Meshes of people have edges of up to 7 mm. Their shading is that of smooth normals, their shape is
flat between vertices, the two up to 6 degrees apart on a nose; photographs of them hold two
surfaces, and no mesh can be true to both.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.light.texture import raster_uv, texture_of
from sim.people.subject import Subject
from sim.scans.subdivide import loop_subdivide

EDGE_MM = 0.5
"""Meshes are subdivided until their median edge is no longer."""


def without_facets(subject: Subject, edge_mm: float = EDGE_MM) -> Subject:
    """A person subdivided smoothly, the normal texture turned along with the surface.

    Args:
        subject: with UV.
        edge_mm: the longest median edge.
    """
    mesh = subject.mesh
    while _median_edge(mesh) > edge_mm:
        mesh = loop_subdivide(mesh)
    rows, columns = subject.normal.shape[:2]
    before = _normals_of_texels(subject.mesh, rows, columns)
    after = _normals_of_texels(mesh, rows, columns)
    return dataclasses.replace(subject, mesh=mesh, normal=turned(subject.normal, before, after))


def turned(vectors: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Vectors (.., 3) turned by the smallest turns from `before` to `after`, unit (.., 3)."""
    both = before + after
    along = np.einsum("...k,...k->...", both, vectors)
    cosine = np.einsum("...k,...k->...", before, after)
    first = np.einsum("...k,...k->...", before, vectors)
    share = (along / np.maximum(1 + cosine, 1e-3))[..., None]
    return np.asarray(vectors - share * both + 2 * first[..., None] * after, np.float32)


def _median_edge(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.triangles()[:, :2]]
    return float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))


def _normals_of_texels(mesh: Mesh, rows: int, columns: int) -> np.ndarray:
    """(rows, columns, 3) smooth normals; beyond the charts those of the nearest texel inside."""
    face, weights = raster_uv(mesh, rows, columns)
    triangles = mesh.triangles()
    normals = texture_of(vertex_normals(mesh.vertices, triangles), triangles, face, weights)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    nearest = ndimage.distance_transform_edt(face < 0, return_distances=False, return_indices=True)
    return np.asarray(normals[tuple(nearest)], np.float32)
