"""A rig from the photographs themselves: cameras from structure from motion, scale from a length.

Nobody measured anything but that length, so all of it is approximate, and marked so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.errors import LightstageError, MotionError, one_error
from lightstage.exif import Exif, read_exif
from lightstage.formats.cameras import SCHEMA
from lightstage.poses_from_photos.lengths import Length, Scale, find_scale, require_known
from lightstage.poses_from_photos.lenses import TypedLens
from lightstage.poses_from_photos.pictures import read_grey
from lightstage.poses_from_photos.points import Clicks
from lightstage.poses_from_photos.solving import MIN_POINTS, Solved, solve
from lightstage.poses_from_photos.suspects import lens_warnings
from lightstage.poses_from_photos.world import (
    looked_at,
    moved,
    turned_by_cameras,
    turned_by_landmarks,
)
from lightstage.rig import Camera, Light, Rig

FAINT_POINTS = 100
"""A camera that sees fewer points than this is warned of."""


@dataclasses.dataclass(frozen=True)
class FoundCameras:
    """What photographs showed.

    Attributes:
        rig: cameras in mm, +y up, +z toward the face's front; lights as given.
        facts: JSON-ready, as calibration/cameras.json of a session has them.
        warnings: what a user should know.
    """

    rig: Rig
    facts: dict[str, Any]
    warnings: list[str]


def find_cameras(
    photographs: Mapping[str, Path],
    lights: tuple[Light, ...],
    lengths: Sequence[Length],
    *,
    clicks: Clicks | None = None,
    landmarks: Clicks | None = None,
    front: str | None = None,
    lenses: Sequence[TypedLens] = (),
    progress: ProgressCallback = quiet,
) -> FoundCameras:
    """Find where the cameras were.

    Args:
        photographs: one of each camera, by its id, all under the same light.
        lights: of the rig to make; nothing is found out about them.
        lengths: measured distances, at least one.
        clicks: points that lengths may name.
        landmarks: of the face; they give its direction, and lengths may name them (0 to 67).
        front: the camera before the face, where there are no landmarks; None for the one in the
            middle of all.
        lenses: who shares a focal length, where that is known.
        progress: called with steps done and in all.

    Raises:
        FormatError: a photograph that cannot be read.
        MotionError: no length, an unknown camera, or photographs that cannot be solved.
    """
    if not lengths:
        raise MotionError(
            "--length",
            found="none",
            expected="a measured distance, such as cam0:cam3=952.6",
            hint="Photographs do not show how large anything is. Measure between two cameras' "
            "lenses, or between two points that --points or --landmarks names.",
        )
    if front is not None and front not in photographs:
        raise MotionError("--front", found=front, expected=f"one of {', '.join(photographs)}")
    named = {**(landmarks or {}), **(clicks or {})}
    require_known(lengths, photographs, named)
    total = len(photographs) + 2
    pictures, exifs = {}, {}
    problems: list[LightstageError] = []
    for done, (name, path) in enumerate(photographs.items()):
        progress(done, total)
        try:
            pictures[name] = read_grey(path)
            exifs[name] = read_exif(path)
        except LightstageError as error:
            problems.append(error)
    if problems:
        raise one_error(problems)
    dark = [name for name, picture in pictures.items() if not picture.lit.any()]
    if dark:
        raise MotionError(
            "cameras", found=f"nothing lit by {', '.join(dark)}", expected="photographs that show"
        )
    progress(total - 2, total)
    solved = solve(pictures, exifs, lenses)
    progress(total - 1, total)
    scale = find_scale(lengths, solved.cameras, named)
    middle = np.median(solved.points, axis=0)
    turn = turned_by_landmarks(landmarks or {}, solved.cameras)
    by = "landmarks"
    if turn is None:
        turn, chosen = turned_by_cameras(solved.cameras, middle, front)
        by = f"camera {chosen}"
    origin = looked_at(solved.cameras, middle)
    cameras = tuple(
        dataclasses.replace(camera, cam_from_world=moved(camera, scale.mm_per_unit, turn, origin))
        for camera in solved.cameras.values()
    )
    progress(total, total)
    warnings = scale.warnings() + [
        f"{name} sees {counted(count, 'point')} alone (of {MIN_POINTS} at least): "
        "its place is uncertain"
        for name, count in solved.seen.items()
        if count < FAINT_POINTS
    ]
    warnings += lens_warnings(solved)
    facts = _facts(cameras, solved, scale, by, exifs)
    return FoundCameras(Rig(lights, cameras), facts, warnings)


def _facts(
    cameras: Sequence[Camera],
    solved: Solved,
    scale: Scale,
    by: str,
    exifs: Mapping[str, Exif],
) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "approximate": True,
        "method": "structure from motion on the photographs themselves; no board was seen",
        "lights": "not measured: those of the rig that was named, or of the default rig",
        "front": by,
        "scale": {
            "lengths": {name: round(share, 5) for name, share in scale.misfits.items()},
            "click_residual_px": (
                None if scale.click_residual_px is None else round(scale.click_residual_px, 3)
            ),
        },
        "lenses": [
            {"cameras": list(lens.cameras), "focal_px": round(lens.focal_px or 0, 2), "by": lens.by}
            for lens in solved.lenses
        ],
        "points": len(solved.points),
        "residual_px": round(float(np.mean(list(solved.residual_px.values()))), 3),
        "cameras": {
            camera.id: {
                "residual_px": round(solved.residual_px[camera.id], 3),
                "points": solved.seen[camera.id],
                "matches": solved.matches[camera.id],
                "focal_px": round(camera.fx_px, 2),
                "focal_told_px": solved.told_px[camera.id],
                "focal_told_mm": exifs[camera.id].focal_mm,
                "distance_mm": round(float(np.linalg.norm(camera.centre_mm)), 2),
            }
            for camera in cameras
        },
    }
