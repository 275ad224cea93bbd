"""Light from skin to skin: what the mesh's vertices receive from each other."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from scipy import sparse

from processing.lighting.interface import Interface
from processing.lighting.lights import PatternLights, Shadows, irradiance_vectors
from processing.rays import CHUNK_RAYS
from processing.surface import LitSurface

START_MM = 0.3
"""Rays to other skin start so far off the mesh."""


def other_skin(surface: LitSurface, rays: int) -> sparse.csr_array:
    """What share of its cosine-weighted sky each vertex of the mesh has from every other one.

    Args:
        surface: the mesh.
        rays: of each vertex, the same well-spread set for all, turned to each normal.

    Returns:
        (coarse, coarse) sparse; a row's sum is the share of sky that skin hides.
    """
    count = surface.coarse
    vertices, normals = surface.vertices[:count], surface.normals[:count]
    tangent = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0]))
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent = np.divide(tangent, length, out=np.zeros_like(tangent), where=length > 0)
    frames = np.stack([tangent, np.cross(normals, tangent), normals], axis=1)
    starts, turned = vertices + START_MM * normals, cosine_directions(rays)
    mesh, step = mesh_triangles(surface), max(1, CHUNK_RAYS // rays)
    parts = []
    for first in range(0, count, step):
        some = slice(first, first + step)
        cast = np.empty((len(starts[some]) * rays, 6), np.float32)
        _fill_rays(starts[some], frames[some], turned, cast)
        met, face, barycentric = surface.rays.met(cast)
        triangles = mesh[face]
        # The inside of an open mesh is no skin.
        corners = surface.vertices[triangles]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        front = np.einsum("nk,nk->n", outward, cast[met, 3:]) < 0
        parts.append((first + met[front] // rays, triangles[front], barycentric[front] / rays))
    owners, triangles, weights = (np.concatenate(each) for each in zip(*parts, strict=True))
    places = np.repeat(owners, 3), triangles.ravel()
    return sparse.csr_array((weights.ravel(), places), shape=(count, count))


@njit(parallel=True, cache=True)
def _fill_rays(starts: np.ndarray, frames: np.ndarray, turned: np.ndarray, out: np.ndarray) -> None:
    """Fill (n r, 6) rays from (n, 3) starts along (r, 3) directions in (n, 3, 3) frames."""
    for i in prange(len(starts)):
        for j in range(len(turned)):
            row = i * len(turned) + j
            for x in range(3):
                out[row, x] = starts[i, x]
                along = turned[j, 0] * frames[i, 0, x] + turned[j, 1] * frames[i, 1, x]
                out[row, 3 + x] = along + turned[j, 2] * frames[i, 2, x]


def mesh_triangles(surface: LitSurface) -> np.ndarray:
    """(t, 3) triangles of the mesh before it was split."""
    if not surface.splits:
        return surface.triangles
    # The outermost corners of a triangle's parts: always the first part's first corner, and so on.
    parts = surface.triangles.reshape(-1, 4**surface.splits, 3)
    first = [sum(k * 4**level for level in range(surface.splits)) for k in range(3)]
    return np.stack([parts[:, first[k], k] for k in range(3)], axis=1)


def cosine_directions(count: int) -> np.ndarray:
    """(count, 3) directions around +z, as dense as the cosine: a spiral on the unit disc."""
    index = np.arange(count) + 0.5
    radius = np.sqrt(index / count)
    angle = index * np.pi * (3 - np.sqrt(5))
    z = np.sqrt(1 - radius**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def vertex_irradiance(
    surface: LitSurface, lights: PatternLights, interface: Interface, roughness: float
) -> np.ndarray:
    """(coarse, P) what enters the skin at the mesh's vertices straight from the lights."""
    count = surface.coarse
    own = np.repeat(np.arange(count, dtype=np.int32)[:, None], 3, axis=1)
    alone = np.tile(np.array([[1, 0, 0]], np.float32), (count, 1))
    shadows = Shadows(own, alone, surface.visible)
    normals = surface.normals[:count]
    vectors = irradiance_vectors(
        lights, surface.vertices[:count], normals, shadows, interface, roughness
    )
    # A camera's polariser halves what it sees, not what lights the skin.
    entered = np.einsum("npk,nk->np", vectors, normals) / lights.diffuse_share
    return np.maximum(entered, 0)


def bounced_light(
    surface: LitSurface,
    between: sparse.csr_array,
    entered: np.ndarray,
    albedo: np.ndarray,
    times: int = 2,
) -> np.ndarray:
    """Irradiance of all vertices by light that other skin sends on.

    Skin is taken as a Lambertian surface of its albedo: that is where most of its light comes from.

    Args:
        surface: the mesh.
        between: of `other_skin`.
        entered: (coarse, P) of `vertex_irradiance`.
        albedo: (coarse, 3).
        times: bounces.

    Returns:
        (V, P, 3) float32, at the vertices of the split mesh too.
    """
    count, patterns = entered.shape
    direct = entered[:, :, None] * np.ones(3)
    arrived = np.zeros_like(direct)
    for _ in range(times):
        sent = (albedo[:, None] * (direct + arrived)).reshape(count, -1)
        arrived = np.asarray(between @ sent).reshape(count, patterns, 3)
    return np.ascontiguousarray(surface.at_all(arrived), np.float32)
