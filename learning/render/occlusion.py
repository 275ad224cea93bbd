"""Cast shadows, baked: which texel of a mesh sees which light (Embree rays through Open3D)."""

from __future__ import annotations

import dataclasses

import numpy as np
from torch import Tensor

from learning.render.environments import Environment
from learning.render.kept_shadows import KeptShadows
from learning.render.light_dome import even_directions
from learning.render.uv import UvRaster, grid_quads
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh

DOME_MM = 100_000.0 * even_directions(64)
"""Lights all round and far away, which a texel sees or not: its ambient occlusion."""
RAYS_AT_ONCE = 2_000_000
OFFSET_MM = 0.3
"""Rays start so far off the surface, along its normal, to pass over the facet they start on."""
SHARPER = 4.0
"""How much sharper the edges of shadows are than the grid that they were baked on."""


@dataclasses.dataclass(frozen=True)
class PositionGrid:
    """A position map as a surface.

    Attributes:
        position_mm: (rows, columns, 3).
        normal: (rows, columns, 3) unit.
        covered: (rows, columns) bool.
        kept: where its shadows are kept; None where they are not.
    """

    position_mm: np.ndarray
    normal: np.ndarray
    covered: np.ndarray
    kept: KeptShadows | None = None


def bake_visibility(
    mesh: Mesh,
    raster: UvRaster,
    position_mm: np.ndarray,
    distant: np.ndarray,
    progress: ProgressCallback = quiet,
    cast_only: bool = False,
) -> np.ndarray:
    """Cast a ray from every texel to every light.

    Args:
        mesh: the surface.
        raster: its texels.
        position_mm: (L, 3) lights.
        distant: (L,) bool, directional lights: only their direction counts.
        progress: called with (rays done, rays in all).
        cast_only: a light below a texel's horizon counts as seen, since the cosine darkens it.

    Returns:
        (L, rows, columns) float32, 1 = seen, 0 = shadowed, below the horizon or no surface.
    """
    covered = raster.covered
    points = raster.interpolate(mesh.vertices)[covered]
    normals = raster.normals(mesh)[covered]
    out = np.zeros((len(position_mm), *covered.shape), np.float32)
    caster = ShadowCaster(mesh.vertices, raster.triangles, points, normals)
    out[:, covered] = caster.seen(position_mm, distant, progress, cast_only)
    return out


def bake_grid(surface: PositionGrid, position_mm: np.ndarray) -> np.ndarray:
    """Shadows of point lights on a position map, whose neighbouring texels make the mesh.

    Args:
        surface: the map.
        position_mm: (L, 3) lights.

    Returns:
        (L, rows, columns) float32, as `bake_visibility`.
    """
    if surface.kept is None:
        return _baked(surface, position_mm)
    size = (*surface.covered.shape,)
    return surface.kept.read_or_bake(size, position_mm, lambda: _baked(surface, position_mm))


def _baked(surface: PositionGrid, position_mm: np.ndarray) -> np.ndarray:
    rows, columns = surface.covered.shape
    quads = grid_quads(surface.position_mm, surface.covered)
    out = np.zeros((len(position_mm), rows, columns), np.float32)
    caster = ShadowCaster(
        surface.position_mm.reshape(-1, 3),
        np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
        surface.position_mm[surface.covered],
        surface.normal[surface.covered],
    )
    out[:, surface.covered] = caster.seen(position_mm, np.zeros(len(position_mm), bool))
    return out


def openness(normal: np.ndarray, dome: np.ndarray) -> np.ndarray:
    """Ambient occlusion: the share of even light from all round that reaches a texel.

    Args:
        normal: (rows, columns, 3) unit.
        dome: (64, rows, columns) visibility, 0..1, of the lights of `DOME_MM`.

    Returns:
        (rows, columns), 0..1, weighted by the cosine.
    """
    direction = DOME_MM / np.linalg.norm(DOME_MM, axis=1, keepdims=True)
    cosine = np.clip(np.einsum("hwc,nc->nhw", normal, direction), 0, None)
    found: np.ndarray = (dome * cosine).sum(axis=0) / np.maximum(cosine.sum(axis=0), 1e-6)
    return found


def sharpened(seen: Tensor, sharpness: float = SHARPER) -> Tensor:
    """Shares of light, 0..1, of an enlarged grid, with edges as hard as small lamps make them.

    Args:
        seen: shares of any shape, 0..1.
        sharpness: factor of the slope of an edge.

    Returns:
        Of the same shape, 0..1.
    """
    return ((seen - 0.5) * sharpness + 0.5).clamp(0, 1)


class ShadowCaster:
    """Points on a surface, and which of them see a light. The tree of triangles is built once."""

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray, normals: np.ndarray
    ) -> None:
        """A surface of (V, 3) vertices and (T, 3) triangles, and n points with their normals."""
        # Importing it takes two seconds, which a training with kept shadows has no use for.
        import open3d

        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices, np.float32)),
            self._tensor(np.ascontiguousarray(triangles, np.uint32)),
        )
        self._starts = (points + OFFSET_MM * normals).astype(np.float32)
        self._normals = normals
        self._reach = 4 * float(np.ptp(vertices, axis=0).max()) + 1.0

    def seen(
        self,
        position_mm: np.ndarray,
        distant: np.ndarray,
        progress: ProgressCallback = quiet,
        cast_only: bool = False,
    ) -> np.ndarray:
        """(L, n) float32 of (L, 3) lights, as `bake_visibility`."""
        starts, normals = self._starts, self._normals
        lights = np.asarray(position_mm, np.float32).reshape(-1, 3)
        out = np.full((len(lights), len(starts)), float(cast_only), np.float32)
        for index, light in enumerate(lights):
            for first in range(0, len(starts), RAYS_AT_ONCE):
                start = starts[first : first + RAYS_AT_ONCE]
                if distant[index]:
                    direction = light / max(float(np.linalg.norm(light)), 1e-9) * self._reach
                    toward = np.broadcast_to(direction, start.shape).astype(np.float32)
                else:
                    toward = light - start
                facing = np.einsum("nk,nk->n", toward, normals[first : first + len(start)]) > 0
                rays = np.concatenate([start[facing], toward[facing]], axis=1)
                blocked = self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=1.0)
                out[index, first + np.flatnonzero(facing)] = ~blocked.numpy()
                progress(index * len(starts) + first + len(start), len(lights) * len(starts))
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
