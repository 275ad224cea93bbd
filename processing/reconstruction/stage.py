"""Stage `reconstruct`: decoded photographs, and coarse normals if any, to base_mesh.ply."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.formats.cameras import approximate_warnings, read_session_cameras
from lightstage.formats.half import float_from_half
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session
from processing.coarse_maps import read_coarse
from processing.errors import ReconstructionError
from processing.frames.read import read_foreground, read_frames
from processing.lighting.lights import PatternLights, pattern_lights
from processing.reconstruction.colmap_folder import read_colmap, require_writable, write_colmap
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.fusion import Holes, alone_share, boundary_loops
from processing.reconstruction.given import facts_of_occluders, given_mesh, read_given
from processing.reconstruction.hull import KEEP_MM, Hull, found_hull
from processing.reconstruction.occluders import OthersBeside, apart, found_occluders, nothing_beside
from processing.reconstruction.pictures import coverage, write_pictures
from processing.reconstruction.poses import (
    PoseReport,
    check_poses,
    drifted,
    in_pixels,
    raise_when_off,
    tone_mapped,
    unchecked,
)
from processing.reconstruction.skin_pixels import skin_alone
from processing.reconstruction.slants import without_normals
from processing.reconstruction.small_views import (
    matched_times,
    of_cells,
    small_view,
    smaller_picture,
)
from processing.reconstruction.stereo import focus_point, match_views, sources_of
from processing.reconstruction.two_passes import Depths, as_known, meshed, reconstruct_in_two_rounds
from processing.reconstruction.views import View, common_basis, make_view, pyramid
from processing.reconstruction.worn import Coloured, joined, without_worn

__all__ = ["ReconstructConfig", "reconstruct", "reconstruct_views"]

CHECKED_ROWS = 1600
"""Poses are checked in pictures of at most twice so many rows."""

PICTURES_ALONE = (
    "lights that give no normals, so the mesh is of matched pictures alone: without relief finer "
    "than their patches, and only where two cameras agree"
)
"""What the facts state of a mesh without photometric normals."""


class Reconstructed(NamedTuple):
    """What views gave.

    Attributes:
        mesh: mm, world.
        holes: its boundary loops.
        facts: JSON-ready.
        shown: of each camera (h, w, 3) uint8, its `coverage`.
        occluders: what else casts shadows, mm, world; None for nothing, or where it was not wanted.
        hull: what may cast shadows where nothing was matched, beside the occluders; None for
            nothing.
    """

    mesh: Mesh
    holes: Holes
    facts: dict[str, Any]
    shown: dict[str, np.ndarray]
    occluders: Mesh | None
    hull: Hull | None = None


def reconstruct(
    session: Session,
    out: Path,
    config: ReconstructConfig,
    progress: ProgressCallback = quiet,
    normals: bool = True,
) -> dict[str, Any]:
    """Reconstruct the face and neck, and write OUT/base_mesh.ply (mm, world).

    Where the configuration names a mesh, that one is written instead; what it names as occluders
    is written as OUT/occluders.ply. What is found of them, with the hull of what was not matched
    at its end, is written there too, and the hull alone in the folder `work`.

    Args:
        session: for its rig.
        out: processed folder with decoded frames, foreground masks and coarse maps.
        config: settings.
        progress: called as views are matched.
        normals: whether the photographs give normals; false matches them as pictures alone.

    Returns:
        Facts: vertices, faces, holes, points, agreement, where normals came from.

    Raises:
        FormatError: an input that an earlier stage should have written.
        PoseError: cameras that are not where the rig has them.
        ReconstructionError: views that do not see one surface, or a given mesh that is not where
            they show the head.
    """
    make = _given if config.mesh else _matched
    poses, found, warnings = make(session, out, config, progress, normals)
    mesh, holes, facts, shown, occluders, hull = found
    if config.occluders and occluders is not None:
        cameras = [session.rig.camera(name) for name in session.camera_ids()]
        facts |= facts_of_occluders(Path(config.occluders), occluders, mesh, cameras)
    folder = ProcessedFolder(out)
    for earlier in (folder.occluders, folder.hull):
        earlier.unlink(missing_ok=True)
    if hull is not None:
        occluders = joined(occluders, hull.mesh)
        write_ply(hull.mesh, folder.hull)
    if occluders is not None:
        write_ply(occluders, folder.occluders)
    write_pictures(out, shown, mesh, occluders, 0 if hull is None else len(hull.mesh.faces))
    write_ply(mesh, folder.base_mesh)
    return {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "outline_mm": round(holes.outline_mm, 1),
        "holes": len(holes.lengths_mm),
        "hole_lengths_mm": [round(length, 1) for length in holes.lengths_mm[:20]],
        **facts,
        "occluder_faces": 0 if occluders is None else len(occluders.faces),
        "hull_cm2": 0.0 if hull is None else round(hull.area_cm2, 1),
        "hull_keeps_off_skin_mm": KEEP_MM,
        "pose_residual_px": {
            camera: None if np.isnan(residual) else round(residual, 3)
            for camera, residual in zip(poses.camera_ids, poses.residual_px, strict=True)
        },
        "pose_matches": dict(zip(poses.camera_ids, poses.matches, strict=True)),
        "pose_tracks": poses.tracks,
        "warnings": _warnings(session, poses, config) + warnings,
    }


class Made(NamedTuple):
    """What `reconstruct` writes, however it was made.

    Attributes:
        poses: what matches show of the cameras.
        found: mesh, facts, pictures.
        warnings: what the user should know of it.
    """

    poses: PoseReport
    found: Reconstructed
    warnings: list[str]


def _given(
    session: Session, out: Path, config: ReconstructConfig, _: ProgressCallback, normals: bool
) -> Made:
    """The mesh that the configuration names."""
    poses = check_session_poses(session, out, config)
    cameras = [session.rig.camera(name) for name in session.camera_ids()]
    mesh, facts, warnings = given_mesh(Path(config.mesh), cameras, poses.points_mm)
    looked = config.find_occluders and normals and not config.occluders and len(cameras) > 1
    views = read_views(session, out, config)[0] if looked else []
    occluders = others_beside(views, config, normals)(mesh)
    hull = found_hull(views, mesh, occluders) if looked and config.find_hull else None
    found = Reconstructed(mesh, boundary_loops(mesh), facts, {}, occluders, hull)
    return Made(poses, found, warnings)


def _matched(
    session: Session,
    out: Path,
    config: ReconstructConfig,
    progress: ProgressCallback,
    normals: bool,
) -> Made:
    """The mesh that the photographs give."""
    with ThreadPoolExecutor(1) as pool:
        # One core finds features: the other one makes the views meanwhile.
        checked = pool.submit(check_session_poses, session, out, config)
        try:
            views, lights = read_views(session, out, config, normals=normals)
        finally:
            # Cameras that stand elsewhere are named first, whatever else is wrong.
            poses = checked.result()
    beside = others_beside(views, config, normals)
    found = reconstruct_views(skin_alone(views), config, progress, lights, beside)
    if not config.occluders and found.occluders is not None:
        # They were found beside the first mesh.
        found = found._replace(occluders=apart(found.occluders, found.mesh))
    if config.find_occluders and not config.occluders and normals:
        found = _undressed(found, session, out)
        if config.find_hull:
            found = found._replace(hull=found_hull(views, found.mesh, found.occluders))
    empty = [view.camera.id for view in views if not np.isfinite(view.textures).any()]
    warnings = [f"{camera} shows nothing and was not used" for camera in empty]
    warnings += [] if normals else [f"{', '.join(lights.patterns)}: {PICTURES_ALONE}"]
    return Made(poses, found, warnings)


def _undressed(found: Reconstructed, session: Session, out: Path) -> Reconstructed:
    """What was found, coloured cloth taken from the skin's mesh to the occluders."""
    cameras = [session.rig.camera(name) for name in session.camera_ids()]
    coloured = [
        Coloured(camera, read_coarse(out, camera.id).picture("diffuse_albedo"))
        for camera in cameras
    ]
    mesh, occluders = without_worn(found.mesh, found.occluders, coloured, focus_point(cameras))
    if mesh is found.mesh:
        return found
    return found._replace(mesh=mesh, holes=boundary_loops(mesh), occluders=occluders)


def others_beside(views: list[View], config: ReconstructConfig, normals: bool) -> OthersBeside:
    """How it is known what else casts shadows: from a file, from the views, or not at all."""
    if config.occluders:
        mesh = read_given(Path(config.occluders))
        return lambda _: mesh
    # Of pictures alone, everything is in the skin's mesh; one view gives no depth.
    if not config.find_occluders or not normals or len(views) < 2:
        return nothing_beside

    def coarsely(some: Sequence[View], how: ReconstructConfig) -> Mesh:
        return reconstruct_views(list(some), how).mesh

    return lambda skin: found_occluders(views, skin, config, coarsely)


def check_session_poses(session: Session, out: Path, config: ReconstructConfig) -> PoseReport:
    """Check the rig against matches between the pictures of the brightest pattern.

    Raises:
        PoseError: cameras that are not where the rig has them, or a rig in another unit.
    """
    cameras, pictures, masks = [], [], []
    rows = max(camera.height_px for camera in session.rig.cameras)
    # Features are found in pictures of half to whole this size: larger ones take minutes.
    times = max(1, matched_times(rows, CHECKED_ROWS) // 2)
    for name in session.camera_ids():
        frames = read_frames(out, name)
        mask = read_foreground(out, name) & frames.valid
        small, inside = smaller_picture(tone_mapped(frames.brightest(), mask), mask, times)
        cameras.append(of_cells(session.rig.camera(name), times))
        pictures.append(small)
        masks.append(inside)
    report = in_pixels(check_poses(pictures, masks, cameras, config), times)
    radius = float(np.median(np.linalg.norm(session.rig.positions_mm, axis=1)))
    raise_when_off(report, radius)
    return report


def read_views(
    session: Session,
    out: Path,
    config: ReconstructConfig,
    patterns: Sequence[str] | None = None,
    normals: bool = True,
) -> tuple[list[View], PatternLights]:
    """All cameras' photographs, foreground masks and coarse normals, as the matcher wants them.

    Args:
        session: for its rig.
        out: processed folder.
        config: how fine.
        patterns: which photographs are matched; None for all.
        normals: whether coarse normals are read; false gives views without any.

    Returns:
        The views, and the lights of their patterns.
    """
    rows = max(camera.height_px for camera in session.rig.cameras)
    times = matched_times(rows, config.finest_rows)
    cameras = session.camera_ids()
    wanted = tuple(patterns or read_frames(out, cameras[0]).patterns)

    small = []
    for name in cameras:
        frames, mask = read_frames(out, name), read_foreground(out, name)
        if normals:
            known, _ = float_from_half(read_coarse(out, name).picture("diffuse_normal"))
        else:
            known = np.zeros((*mask.shape, 3), np.float32)
        small.append(small_view(session.rig.camera(name), frames, mask, known, times, wanted))
    lights = pattern_lights(session, wanted)
    white = lights.colour if normals else None
    basis = common_basis([s.images for s in small], [s.mask & s.valid for s in small])

    return [
        make_view(s.camera, s.images, s.valid, s.mask, s.normals, basis, white) for s in small
    ], lights


def reconstruct_views(
    views: list[View],
    config: ReconstructConfig,
    progress: ProgressCallback = quiet,
    lights: PatternLights | None = None,
    beside: OthersBeside = nothing_beside,
) -> Reconstructed:
    """From views to a mesh: the pure part of the stage.

    Args:
        views: at least two that see the same surface from different places.
        config: settings.
        progress: called as views are matched.
        lights: of the patterns that the views' signals are of, where they have signals.
        beside: finds what else casts shadows beside a first mesh of the skin.

    Raises:
        ReconstructionError: fewer than two views show anything, or no points agree.
        FormatError: a COLMAP folder that is named and is none, or that would not be replaced.
    """
    showing = [view.camera.id for view in views if np.isfinite(view.textures).any()]
    if len(showing) < 2:
        raise ReconstructionError(
            "reconstruct",
            found=f"something to see in {counted(len(showing), 'view')}",
            expected="at least two that overlap",
            hint="Are the photographs black, or the cameras turned away?"
            if len(views) > 1
            else "One camera makes no mesh: give your own with --mesh, or take its coarse maps "
            "with --until separate.",
        )
    names = [view.camera.id for view in views]
    if config.colmap_to:
        require_writable(Path(config.colmap_to))
    if config.colmap_from:
        level = pyramid(views, config.finest_rows, config.coarsest_rows)[-1]
        read: Depths = level, *read_colmap(Path(config.colmap_from), names, level)
        found, plain = as_known(views, read, config)
        points, mesh = meshed(found, plain)
        occluders = beside(mesh)
    else:
        found = match_views(views, config, progress)
        found, points, mesh, occluders = reconstruct_in_two_rounds(
            views, found, config, lights, progress, beside
        )
    level, depths, _ = found
    if config.colmap_to:
        write_colmap(Path(config.colmap_to), names, level, depths, sources_of(views, config))
    matched = sum(int((depth > 0).sum()) for depth in depths)
    facts: dict[str, Any] = {
        "normals": "none: pictures alone" if without_normals(views) else "photometric",
        "matched_pixels": matched,
        "points": len(points.positions),
        "agreeing_share": round(int((points.views > 0).sum()) / max(matched, 1), 4),
        "alone_share": round(alone_share(mesh, points), 4),
    }
    facts["coverage"] = {
        name: round(float((count > 0).sum() / max(int(mask.sum()), 1)), 3)
        for name, count, mask in zip(names, points.agreeing, level.masks, strict=True)
    }
    each = zip(names, points.agreeing, level.masks, strict=True)
    shown = {name: coverage(count, mask) for name, count, mask in each}
    return Reconstructed(mesh, boundary_loops(mesh), facts, shown, occluders)


def _warnings(session: Session, poses: PoseReport, config: ReconstructConfig) -> list[str]:
    warnings = approximate_warnings(read_session_cameras(session))
    known = set(session.camera_ids())
    warnings += [f"{c.id} has no photographs" for c in session.rig.cameras if c.id not in known]
    return warnings + unchecked(poses, config) + drifted(poses, config)
