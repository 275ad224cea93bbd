"""What else casts shadows: clothes, hair, a headrest, found in the pictures beside the skin.

Photometric normals come from colour, and grey cloth has none. So where the photographs show
something in front of the dark that the skin's mesh does not cover, it is matched as pictures alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera
from processing.closest import ClosestPoints
from processing.errors import ReconstructionError
from processing.rays import MeshRays
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.fusion import compact
from processing.reconstruction.pieces import larger_pieces
from processing.reconstruction.views import View

ROWS = 800
"""Pictures of so many rows at most: shadows need no finer shape."""
MARGIN_PX = 1
"""So many pixels of these beside the skin are left out: edges show both."""
LEAST_SHARE = 0.02
"""Share of the foreground that no skin covers, below which nothing is searched."""
CELL, AGREE, REACH = 2.5, 5.0, 6.0
"""Factors on the skin's cells, on how well views agree, and on how far from its points the surface
reaches: smooth cloth has few matches, and holes let light through. Of a grey collar's front 95 %
were found within 3 mm so, 88 % with the skin's own reach; a fortieth was off by more than 4 mm."""
OFF_SKIN_MM = 2.0
"""What is nearer to the skin's mesh would shadow its own surface."""
LEAST_CM2 = 10.0
"""Smaller pieces are matches that went wrong."""

Reconstruct = Callable[[Sequence[View], ReconstructConfig], Mesh]
"""From views to a mesh; ReconstructionError where they show no common surface."""


OthersBeside = Callable[[Mesh], Mesh | None]
"""Finds what else casts shadows beside a mesh of the skin; None for nothing."""


def nothing_beside(_: Mesh) -> None:
    """For runs that search for nothing."""


def found_occluders(
    views: Sequence[View], skin: Mesh, config: ReconstructConfig, reconstruct: Reconstruct
) -> Mesh | None:
    """What the views show beside the skin.

    Args:
        views: with their foregrounds.
        skin: mm, world.
        config: settings of the skin's mesh.
        reconstruct: makes a mesh of views.

    Returns:
        Its mesh, mm, world; None where there is nothing of any size.
    """
    rays = MeshRays(skin.vertices, skin.triangles())
    rest = [_beside(view, rays) for view in views]
    foreground = sum(int(view.mask.sum()) for view in views)
    if sum(int(view.mask.sum()) for view in rest) < LEAST_SHARE * foreground:
        return None
    coarse = dataclasses.replace(
        config,
        finest_rows=min(ROWS, config.finest_rows),
        look_again=False,
        agree_mm=AGREE * config.agree_mm,
        cell_mm=CELL * config.cell_mm,
        settle_mm=CELL * config.settle_mm,
        trim_mm=REACH * config.trim_mm,
        splits=0,
        colmap_to="",
        colmap_from="",
    )
    try:
        mesh = reconstruct(rest, coarse)
    except ReconstructionError:
        return None  # no two views agree on anything
    return apart(mesh, skin)


def _beside(view: View, rays: MeshRays) -> View:
    """The view without the skin, and without normals."""
    camera = view.camera
    small = camera.scaled(min(1.0, ROWS / camera.height_px))
    covered = _covered(small, rays)
    size = (view.mask.shape[1], view.mask.shape[0])
    mask = view.mask & (cv2.resize(covered, size, interpolation=cv2.INTER_NEAREST) == 0)
    textures = np.where(mask[..., None], view.textures, np.float32(np.nan))
    return View(camera, textures, mask, np.zeros_like(view.normals))


def _covered(camera: Camera, rays: MeshRays) -> np.ndarray:
    """(h, w) uint8: 1 where a camera sees the skin, and around it."""
    hit = rays.cast_camera(camera).face.reshape(camera.height_px, camera.width_px) >= 0
    kernel = np.ones((2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1), np.uint8)
    return np.asarray(cv2.dilate(hit.astype(np.uint8), kernel))


def apart(mesh: Mesh, skin: Mesh) -> Mesh | None:
    """The pieces of a mesh that are off the skin and are large enough; None where none is."""
    closest = ClosestPoints(skin.vertices, skin.triangles())
    off = closest.query(mesh.vertices).distance_mm > OFF_SKIN_MM
    kept = larger_pieces(mesh, off[mesh.faces].all(axis=1), LEAST_CM2)
    return compact(mesh.vertices, mesh.faces[kept]) if kept.any() else None
