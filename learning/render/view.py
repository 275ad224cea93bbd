"""A textured mesh as a camera sees it."""

from __future__ import annotations

import dataclasses

import numpy as np
import open3d

from learning.render.uv import spread_outside
from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera

SUPERSAMPLE = 2
"""Rays a side of a pixel."""
BAND_ROWS = 512
"""Rows of the picture whose rays are held in memory together."""


def render_view(
    texture: np.ndarray,
    known: np.ndarray,
    mesh: Mesh,
    camera: Camera,
    background: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Show a texture on its mesh.

    Args:
        texture: (rows, columns, 3) linear, already shaded for this camera.
        known: (rows, columns) bool, texels that hold a surface; the rest of the mesh is not shown.
        mesh: with UV.
        camera: the view.
        background: linear grey where no surface is.

    Returns:
        (h, w, 3) float32 linear and (h, w) float32 alpha, the share of the pixel that is surface.
    """
    if mesh.uvs is None:
        raise FormatError("mesh", field="uv", found="none", expected="texture coordinates")
    scene = scene_of(mesh)
    corner_uvs = mesh.uvs[mesh.triangle_uvs()]
    rgba = np.concatenate([spread_outside(texture, known), known[..., None]], axis=2)
    rgba = rgba.astype(np.float32)
    pixels = np.empty((camera.height_px, camera.width_px, 4), np.float32)
    for top in range(0, camera.height_px, BAND_ROWS):
        height = min(BAND_ROWS, camera.height_px - top)
        band = dataclasses.replace(camera, height_px=height, cy_px=camera.cy_px - top)
        pixels[top : top + height] = _band(scene, corner_uvs, rgba, band)
    alpha = pixels[..., 3]
    return pixels[..., :3] + background * (1 - alpha[..., None]), alpha


def scene_of(mesh: Mesh) -> open3d.t.geometry.RaycastingScene:
    """A mesh as rays are cast at it."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(np.ascontiguousarray(mesh.vertices, np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(mesh.triangles(), np.uint32)),
    )
    return scene


def cast_from(
    scene: open3d.t.geometry.RaycastingScene, origin_mm: np.ndarray, directions: np.ndarray
) -> dict[str, np.ndarray]:
    """What rays from one place meet first: t_hit (infinite where nothing), primitive_ids and _uvs.

    Args:
        scene: of `scene_of`.
        origin_mm: (3,).
        directions: (..., 3), each of a length that t_hit counts in.

    Returns:
        Open3D's arrays by name, one entry a ray, in order.
    """
    flat = directions.reshape(-1, 3)
    rays = np.empty((len(flat), 6), np.float32)
    rays[:, :3], rays[:, 3:] = origin_mm, flat
    found = scene.cast_rays(open3d.core.Tensor(rays))
    return {name: found[name].numpy() for name in ("t_hit", "primitive_ids", "primitive_uvs")}


def _band(
    scene: open3d.t.geometry.RaycastingScene,
    corner_uvs: np.ndarray,
    rgba: np.ndarray,
    camera: Camera,
) -> np.ndarray:
    """(h, w, 4) of a camera; rgb is weighted by alpha."""
    fine = dataclasses.replace(
        camera,
        width_px=camera.width_px * SUPERSAMPLE,
        height_px=camera.height_px * SUPERSAMPLE,
        fx_px=camera.fx_px * SUPERSAMPLE,
        fy_px=camera.fy_px * SUPERSAMPLE,
        cx_px=camera.cx_px * SUPERSAMPLE,
        cy_px=camera.cy_px * SUPERSAMPLE,
    )
    found = cast_from(scene, *fine.pixel_rays())
    hit = np.isfinite(found["t_hit"])
    weights = found["primitive_uvs"][hit]
    barycentric = np.concatenate([1 - weights.sum(axis=1, keepdims=True), weights], axis=1)
    corners = corner_uvs[found["primitive_ids"][hit]]
    samples = np.zeros((len(hit), 4), np.float32)
    samples[hit] = sample_bilinear(rgba, np.einsum("nck,nc->nk", corners, barycentric))
    samples[:, :3] *= samples[:, 3:]
    shape = (camera.height_px, SUPERSAMPLE, camera.width_px, SUPERSAMPLE, 4)
    return samples.reshape(shape).mean(axis=(1, 3))


def sample_bilinear(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Sample a texture at OBJ's (n, 2) uv; at the picture's border the border texel counts.

    Args:
        image: (rows, columns, k); row 0 is the top, v = 1 - 0.5 / rows at its centre.
        uv: (n, 2).

    Returns:
        (n, k).
    """
    rows, columns = image.shape[:2]
    x = np.clip(uv[:, 0] * columns - 0.5, 0, columns - 1)
    y = np.clip((1 - uv[:, 1]) * rows - 0.5, 0, rows - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, bottom = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
    fx = (x - left)[:, None].astype(image.dtype)
    fy = (y - top)[:, None].astype(image.dtype)
    upper = image[top, left] * (1 - fx) + image[top, right] * fx
    lower = image[bottom, left] * (1 - fx) + image[bottom, right] * fx
    return upper * (1 - fy) + lower * fy
