"""Stage `reconstruct`: decoded photographs and coarse normals to base_mesh.ply."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from processing.errors import ReconstructionError
from processing.frames import Frames, read_foreground, read_frames
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.consistency import consistent_points
from processing.reconstruction.fusion import Holes, boundary_loops, fuse
from processing.reconstruction.stereo import match_views
from processing.reconstruction.views import View, common_basis, make_view

__all__ = ["ReconstructConfig", "reconstruct", "reconstruct_views"]


def reconstruct(
    session: Session, out: Path, config: ReconstructConfig, progress: ProgressCallback = quiet
) -> dict[str, Any]:
    """Reconstruct the face and neck, and write OUT/base_mesh.ply (mm, world).

    Args:
        session: for its rig.
        out: processed folder with decoded frames, foreground masks and views' diffuse normals.
        config: settings.
        progress: called as views are matched.

    Returns:
        Facts: vertices, faces, holes, points, agreement.

    Raises:
        FormatError: an input that an earlier stage should have written.
        ReconstructionError: views that do not see one surface.
    """
    views = read_views(session, out)
    mesh, holes, facts = reconstruct_views(views, config, progress)
    write_ply(mesh, ProcessedFolder(out).base_mesh)
    return {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "outline_mm": round(holes.outline_mm, 1),
        "holes": len(holes.lengths_mm),
        "hole_lengths_mm": [round(length, 1) for length in holes.lengths_mm[:20]],
        **facts,
        "warnings": _warnings(session, views),
    }


def read_views(session: Session, out: Path) -> list[View]:
    """All cameras' photographs, foreground masks and coarse normals, as the matcher wants them."""
    folder = ProcessedFolder(out)
    cameras = session.camera_ids()
    frames: list[Frames] = [read_frames(out, camera) for camera in cameras]
    masks = [read_foreground(out, camera) for camera in cameras]
    images = [frame.images for frame in frames]
    usable = [mask & frame.valid for mask, frame in zip(masks, frames, strict=True)]
    basis = common_basis(images, usable)
    return [
        make_view(
            session.rig.camera(camera),
            frame.images,
            frame.valid,
            mask,
            folder.read_view(camera, "diffuse_normal"),
            basis,
        )
        for camera, frame, mask in zip(cameras, frames, masks, strict=True)
    ]


def reconstruct_views(
    views: list[View], config: ReconstructConfig, progress: ProgressCallback = quiet
) -> tuple[Mesh, Holes, dict[str, Any]]:
    """From views to a mesh: the pure part of the stage.

    Args:
        views: at least two that see the same surface from different places.
        config: settings.
        progress: called as views are matched.

    Returns:
        The mesh, its holes, and facts.

    Raises:
        ReconstructionError: fewer than two views show anything, or no points agree.
    """
    showing = [view.camera.id for view in views if np.isfinite(view.textures).any()]
    if len(showing) < 2:
        raise ReconstructionError(
            "reconstruct",
            found=f"{len(showing)} views that show something",
            expected="at least two that overlap",
            hint="Are the photographs black, or the cameras turned away?",
        )
    level, depths, costs = match_views(views, config, progress)
    matched = sum(int((depth > 0).sum()) for depth in depths)
    points = consistent_points(level, depths, costs, config)
    mesh = fuse(points, config)
    facts = {
        "matched_pixels": matched,
        "points": len(points.positions),
        "agreeing_share": round(len(points.positions) / max(matched, 1), 4),
    }
    return mesh, boundary_loops(mesh), facts


def _warnings(session: Session, views: list[View]) -> list[str]:
    empty = [view.camera.id for view in views if not np.isfinite(view.textures).any()]
    said = [f"{camera} shows nothing and was not used" for camera in empty]
    known = {view.camera.id for view in views}
    said += [f"{c.id} has no photographs" for c in session.rig.cameras if c.id not in known]
    return said
