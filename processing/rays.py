"""Rays against a mesh (Embree through Open3D): what a camera sees, which lights a point sees."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numba import njit, prange

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera
from processing import late_open3d as open3d

CHUNK_RAYS = 4_000_000


@dataclasses.dataclass(frozen=True)
class Hits:
    """What rays met; fields hold one entry a ray.

    Attributes:
        face: (n,) int32 triangle index, -1 where nothing was met.
        barycentric: (n, 3) float32 weights of the triangle's corners.
        distance_mm: (n,) float32 along the unit ray, infinite where nothing was met.
    """

    face: np.ndarray
    barycentric: np.ndarray
    distance_mm: np.ndarray


class MeshRays:
    """A mesh prepared for ray queries."""

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, occluders: Mesh | None = None
    ) -> None:
        """Build the hierarchy.

        Args:
            vertices: (n, 3) mm.
            triangles: (t, 3).
            occluders: what hides the mesh from lights and cameras and is never met itself.
        """
        self._scene = open3d.t.geometry.RaycastingScene()
        self._mesh = self._add(vertices, triangles)
        if occluders is not None:
            self._add(occluders.vertices, occluders.triangles())

    def _add(self, vertices: np.ndarray, triangles: np.ndarray) -> int:
        return int(
            self._scene.add_triangles(
                open3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
                open3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
            )
        )

    def cast(self, origins_mm: np.ndarray, directions: np.ndarray) -> Hits:
        """First hit of rays from (n, 3) origins (or one (3,)) along (n, 3) unit directions.

        A ray that an occluder stops meets nothing.
        """
        found = self._found(origins_mm, directions)
        missed = found["geometry_ids"].numpy() != self._mesh
        face = found["primitive_ids"].numpy().astype(np.int64)
        distance_mm = found["t_hit"].numpy()
        face[missed], distance_mm[missed] = -1, np.inf
        uv = found["primitive_uvs"].numpy()
        barycentric = np.stack([1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], axis=1)
        return Hits(face.astype(np.int32), barycentric, distance_mm)

    def met(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which of (n, 6) float32 rays, origins and unit directions, meet the mesh, and where.

        Returns:
            (m,) their numbers, (m,) triangles, and (m, 3) float32 weights of the corners.
        """
        found = self._scene.cast_rays(open3d.core.Tensor(rays))
        met = np.flatnonzero(found["geometry_ids"].numpy() == self._mesh)
        face = found["primitive_ids"].numpy()[met].astype(np.int64)
        uv = found["primitive_uvs"].numpy()[met]
        return met, face, np.stack([1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], axis=1)

    def _found(self, origins_mm: np.ndarray, directions: np.ndarray) -> Any:
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3] = origins_mm
        rays[:, 3:] = directions
        return self._scene.cast_rays(open3d.core.Tensor(rays))

    def stopped(self, camera: Camera, mask: np.ndarray) -> np.ndarray:
        """(h, w) bool: pixels of a (h, w) bool mask at which a camera sees an occluder."""
        out = np.zeros(mask.shape, bool)
        rows, columns = np.nonzero(mask)
        nothing = open3d.t.geometry.RaycastingScene.INVALID_ID
        for first in range(0, len(rows), CHUNK_RAYS):
            some = rows[first:][:CHUNK_RAYS], columns[first:][:CHUNK_RAYS]
            directions = camera.rays_through(some[1] + 0.5, some[0] + 0.5)
            met = self._found(camera.centre_mm, directions)["geometry_ids"].numpy()
            out[some] = (met != self._mesh) & (met != nothing)
        return out

    def cast_camera(self, camera: Camera, mask: np.ndarray | None = None) -> Hits:
        """First hits of a camera's pixels, in row order.

        Args:
            camera: the view.
            mask: (h, w) bool, only these pixels are cast (the others read -1).

        Returns:
            Hits of h * w entries.
        """
        shape = (camera.height_px, camera.width_px)
        chosen = np.ones(shape, bool) if mask is None else mask
        some, _ = self.cast_pixels(camera, *np.nonzero(chosen))
        count, chosen = chosen.size, chosen.ravel()
        hits = Hits(
            np.full(count, -1, np.int32),
            np.zeros((count, 3), np.float32),
            np.full(count, np.inf, np.float32),
        )
        hits.face[chosen] = some.face
        hits.barycentric[chosen] = some.barycentric
        hits.distance_mm[chosen] = some.distance_mm
        return hits

    def cast_pixels(
        self, camera: Camera, rows: np.ndarray, columns: np.ndarray
    ) -> tuple[Hits, np.ndarray]:
        """First hits of some of a camera's pixels.

        Args:
            camera: the view.
            rows, columns: (n,) whole numbers.

        Returns:
            Hits of n entries, and the rays' (n, 3) unit directions, float64.
        """
        directions = camera.rays_through(columns + 0.5, rows + 0.5)
        return self.cast(camera.centre_mm, directions), directions

    def visible(
        self,
        points_mm: np.ndarray,
        normals: np.ndarray,
        targets_mm: np.ndarray,
        *,
        offset_mm: float = 0.1,
        progress: ProgressCallback = quiet,
    ) -> np.ndarray:
        """Which targets (lights, cameras) each surface point sees.

        A target below the point's horizon is not visible and costs no ray.

        Args:
            points_mm: (n, 3) on the surface.
            normals: (n, 3) the mesh's unit normals there.
            targets_mm: (m, 3).
            offset_mm: how far along its normal a ray starts, so that it does not meet its own face.

        Returns:
            (n, m) bool.
        """
        upward = np.ascontiguousarray(normals, np.float32)
        start = np.ascontiguousarray(points_mm, np.float32) + offset_mm * upward
        targets = np.ascontiguousarray(targets_mm, np.float32)
        out = np.zeros((len(start), len(targets)), bool)
        step = max(1, CHUNK_RAYS // max(1, len(targets)))
        for first in range(0, len(start), step):
            part = slice(first, first + step)
            # What faces each other is marked, and then what is in each other's way unmarked.
            _mark_facing(start[part], upward[part], targets, out[part])
            until = np.cumsum(np.count_nonzero(out[part], axis=1))
            rays = np.empty((int(until[-1]), 6), np.float32)
            _fill_rays(start[part], targets, out[part], until, rays)
            blocked = self._scene.test_occlusions(open3d.core.Tensor(rays), tnear=0.0, tfar=1.0)
            _unmark(blocked.numpy(), until, out[part])
            progress(min(first + step, len(start)), len(start))
        return out


@njit(parallel=True, cache=True)
def _mark_facing(
    start: np.ndarray, normals: np.ndarray, targets: np.ndarray, out: np.ndarray
) -> None:
    for i in prange(len(start)):
        for j in range(len(targets)):
            height = np.float32(0)
            for k in range(3):
                height += (targets[j, k] - start[i, k]) * normals[i, k]
            out[i, j] = height > 0


@njit(parallel=True, cache=True)
def _fill_rays(
    start: np.ndarray, targets: np.ndarray, marked: np.ndarray, until: np.ndarray, rays: np.ndarray
) -> None:
    for i in prange(len(start)):
        n = until[i - 1] if i else 0
        for j in range(len(targets)):
            if marked[i, j]:
                for k in range(3):
                    rays[n, k] = start[i, k]
                    rays[n, 3 + k] = targets[j, k] - start[i, k]
                n += 1


@njit(parallel=True, cache=True)
def _unmark(blocked: np.ndarray, until: np.ndarray, out: np.ndarray) -> None:
    for i in prange(len(out)):
        n = until[i - 1] if i else 0
        for j in range(out.shape[1]):
            if out[i, j]:
                out[i, j] = not blocked[n]
                n += 1


def interpolate(values: np.ndarray, triangles: np.ndarray, hits: Hits) -> np.ndarray:
    """Per-vertex values at hits.

    Args:
        values: (v, k) per vertex.
        triangles: (t, 3).
        hits: n hits.

    Returns:
        (n, k); zero where nothing was met.
    """
    corners = values[triangles[np.maximum(hits.face, 0)]]
    out = np.einsum("nck,nc->nk", corners, hits.barycentric)
    out[hits.face < 0] = 0
    return out
