"""Mitsuba's rays against a triangle mesh, in whichever variant works."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.reference.variant import LLVM, SCALAR, mitsuba

CHUNK = 4_000_000
"""Rays that are traced at once; it bounds memory."""


class Rays:
    """A mesh that rays can hit.

    Args:
        vertices_mm: (n, 3).
        triangles: (t, 3).
        variant: of Mitsuba.
    """

    def __init__(self, vertices_mm: np.ndarray, triangles: np.ndarray, variant: str) -> None:
        self.variant = variant
        mi = mitsuba(variant)
        mesh = mi.Mesh("skin", len(vertices_mm), len(triangles))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ravel(vertices_mm).astype(np.float32)
        parameters["faces"] = np.ravel(triangles).astype(np.uint32)
        parameters.update()
        self.scene = mi.load_dict({"type": "scene", "skin": mesh})

    def hit(self, origins_mm: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First hits of rays.

        Args:
            origins_mm: (n, 3) or (3,).
            directions: (n, 3) unit.

        Returns:
            (n,) int32 triangle, -1 for none, and (n, 3) float32 barycentric weights.
        """
        origins = np.broadcast_to(origins_mm, directions.shape)
        face = np.full(len(directions), -1, np.int32)
        weights = np.zeros((len(directions), 3), np.float32)
        trace = _hit_one_by_one if self.variant == SCALAR else _hit_many
        for first in range(0, len(directions), CHUNK):
            part = slice(first, first + CHUNK)
            found, u, v = trace(self, origins[part], directions[part])
            face[part] = found
            weights[part] = np.stack([1 - u - v, u, v], axis=1)
        return face, weights


def _hit_many(
    rays: Rays, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    mi = mitsuba(LLVM)
    import drjit

    ray = mi.Ray3f(vectors(mi.Point3f, origins), vectors(mi.Vector3f, directions))
    found = rays.scene.ray_intersect_preliminary(ray, coherent=False)
    drjit.eval(found)
    face = np.where(np.array(found.is_valid()), np.array(found.prim_index).astype(np.int64), -1)
    u, v = (np.array(part) for part in (found.prim_uv.x, found.prim_uv.y))
    seen = face >= 0
    return face, np.where(seen, u, 0), np.where(seen, v, 0)


def _hit_one_by_one(
    rays: Rays, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    mi = mitsuba(SCALAR)
    out = np.zeros((len(directions), 3))
    out[:, 0] = -1
    for i, (start, toward) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
        found = rays.scene.ray_intersect_preliminary(mi.Ray3f(start, toward), coherent=False)
        if found.is_valid():
            out[i] = found.prim_index, found.prim_uv.x, found.prim_uv.y
    return out[:, 0].astype(np.int64), out[:, 1], out[:, 2]


def vectors(kind: Any, values: np.ndarray) -> Any:
    """(n, 3) values as one of Dr.Jit's arrays of three rows."""
    return kind(np.ascontiguousarray(np.asarray(values).T, np.float32))
