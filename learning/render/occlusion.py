"""Cast shadows, baked: which texel of a mesh sees which light (Embree rays through Open3D)."""

from __future__ import annotations

import numpy as np
import open3d

from learning.render.environments import Environment
from learning.render.uv import UvRaster
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh

RAYS_AT_ONCE = 2_000_000
OFFSET_MM = 0.3
"""Rays start so far off the surface, along its normal, to pass over the facet they start on."""


def bake_visibility(
    mesh: Mesh,
    raster: UvRaster,
    position_mm: np.ndarray,
    distant: np.ndarray,
    progress: ProgressCallback = quiet,
) -> np.ndarray:
    """Cast a ray from every texel to every light.

    Args:
        mesh: the surface.
        raster: its texels.
        position_mm: (L, 3) lights.
        distant: (L,) bool, directional lights: only their direction counts.
        progress: called with (rays done, rays in all).

    Returns:
        (L, rows, columns) float32, 1 = seen, 0 = shadowed, below the horizon or no surface.
    """
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(np.ascontiguousarray(mesh.vertices, np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(raster.triangles, np.uint32)),
    )
    covered = raster.covered
    normals = raster.normals(mesh)[covered]
    starts = raster.interpolate(mesh.vertices)[covered] + OFFSET_MM * normals
    lights = np.asarray(position_mm, np.float32).reshape(-1, 3)
    reach = 4 * float(np.ptp(mesh.vertices, axis=0).max()) + 1.0
    out = np.zeros((len(lights), *covered.shape), np.float32)
    for index, light in enumerate(lights):
        seen = np.zeros(len(starts), bool)
        for first in range(0, len(starts), RAYS_AT_ONCE):
            start = starts[first : first + RAYS_AT_ONCE]
            if distant[index]:
                direction = light / max(float(np.linalg.norm(light)), 1e-9) * reach
                toward = np.broadcast_to(direction, start.shape).astype(np.float32)
            else:
                toward = light - start
            facing = np.einsum("nk,nk->n", toward, normals[first : first + len(start)]) > 0
            rays = np.concatenate([start[facing], toward[facing]], axis=1)
            blocked = scene.test_occlusions(open3d.core.Tensor(rays), tnear=0.0, tfar=1.0)
            seen[first + np.flatnonzero(facing)] = ~blocked.numpy()
            progress(index * len(starts) + first + len(start), len(lights) * len(starts))
        out[index, covered] = seen
    return out


def bake_environment(
    mesh: Mesh, raster: UvRaster, environment: Environment, progress: ProgressCallback = quiet
) -> np.ndarray:
    """`bake_visibility` of an environment of batch one."""
    return bake_visibility(
        mesh,
        raster,
        environment.position_mm[0].cpu().numpy(),
        environment.distant[0].cpu().numpy(),
        progress,
    )
