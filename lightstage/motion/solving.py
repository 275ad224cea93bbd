"""Small pictures to cameras in COLMAP's own units: the process that solves, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.counting import counted
from lightstage.errors import LightstageError, MotionError, one_error
from lightstage.exif import Exif
from lightstage.formats.files import read_json
from lightstage.motion.pictures import GreyPicture
from lightstage.rig import Camera

MIN_CAMERAS = 3
"""Two photographs do not tell a focal length."""
MIN_MATCHES = 15
"""Verified matches that a camera must have with another one."""
MIN_POINTS = 20
MAX_RESIDUAL_SHARE = 0.002
"""Of a picture's longer side: mean residual of a camera's points above which it is refused."""
FULL_FRAME_MM = 36.0
"""Width of the film that focal lengths are told for."""


@dataclasses.dataclass(frozen=True)
class Solved:
    """Cameras that fit one another.

    Attributes:
        cameras: id to camera; the world and its unit are COLMAP's own.
        points: (n, 3) of the surface, in the same world.
        residual_px: id to mean residual of its points, pixels of its photographs.
        seen: id to how many points it sees.
        matches: id to verified matches with all others.
        from_exif: id to whether its focal length began with what its photograph says.
    """

    cameras: dict[str, Camera]
    points: np.ndarray
    residual_px: dict[str, float]
    seen: dict[str, int]
    matches: dict[str, int]
    from_exif: dict[str, bool]


def solve(pictures: Mapping[str, GreyPicture], told: Mapping[str, Exif]) -> Solved:
    """Find cameras from one photograph of each.

    Photographs of one size, model and focal length share a focal length and a term of distortion;
    the principal point is the picture's middle.

    Args:
        pictures: by camera id.
        told: what each photograph says of itself.

    Raises:
        MotionError: naming every camera that has too few matches, no place among the others or a
            residual too large; or that nothing could be solved.
    """
    names = list(pictures)
    if len(names) < MIN_CAMERAS:
        raise MotionError(
            "cameras",
            found=f"photographs of {', '.join(names) or 'none'}",
            expected=f"{MIN_CAMERAS} cameras at least",
            hint="Two photographs do not tell a focal length; give --rig.",
        )
    keys = [_group_key(pictures[name], told[name]) for name in names]
    groups = list(dict.fromkeys(keys))
    group_of = {name: groups.index(key) for name, key in zip(names, keys, strict=True)}
    with tempfile.TemporaryDirectory(prefix="lightstage-motion-") as place:
        folder = Path(place)
        for name, picture in pictures.items():
            _put(folder, group_of[name], name, picture)
        first = [next(n for n in names if group_of[n] == g) for g in range(len(groups))]
        job = {"groups": [_group(pictures[name], told[name]) for name in first]}
        (folder / "job.json").write_text(json.dumps(job))
        result = _run(folder)
    matches = dict.fromkeys(names, 0)
    best = dict.fromkeys(names, 0)
    for one, other, count in result["pairs"]:
        for name in (one, other):
            matches[name] += count
            best[name] = max(best[name], count)
    found = result["cameras"]
    _refuse(names, best, found, pictures)
    return Solved(
        {name: _camera(name, pictures[name], told[name], found[name]) for name in names},
        np.array(result["points"], float).reshape(-1, 3),
        {name: pictures[name].times * found[name]["residual_px"] for name in names},
        {name: found[name]["points"] for name in names},
        matches,
        {name: _focal_px(pictures[name], told[name]) is not None for name in names},
    )


def _refuse(
    names: list[str],
    best: Mapping[str, int],
    found: Mapping[str, Any],
    pictures: Mapping[str, GreyPicture],
) -> None:
    problems: list[LightstageError] = []

    def refuse(name: str, saw: str, expected: str, hint: str) -> None:
        problems.append(MotionError(f"camera {name}", found=saw, expected=expected, hint=hint))

    if not found and min(best.values()) >= MIN_MATCHES:
        raise MotionError(
            "cameras",
            found="photographs whose matches give no depth",
            expected="one subject from places around it",
            hint="Were all taken from one place, or is what they show flat?",
        )
    for name in names:
        if best[name] < MIN_MATCHES:
            refuse(
                name,
                f"{counted(best[name], 'match', 'matches')} with the camera that fits best",
                f"{MIN_MATCHES} at least",
                "Does it show the same subject, sharp, within 30 degrees of another camera?",
            )
        elif found and (name not in found or found[name]["points"] < MIN_POINTS):
            refuse(
                name,
                "matches, but no place among " + ", ".join(n for n in names if n in found),
                "one group of cameras that see each other's subject",
                "Add views between the groups, or leave its photographs out.",
            )
        elif found:
            picture = pictures[name]
            limit = MAX_RESIDUAL_SHARE * max(picture.grey.shape)
            if found[name]["residual_px"] > limit:
                refuse(
                    name,
                    f"points {picture.times * found[name]['residual_px']:.1f} px off (mean)",
                    f"at most {picture.times * limit:.1f} px",
                    "Did the subject move between the photographs?",
                )
    if problems:
        raise one_error(problems)


def _put(folder: Path, group: int, name: str, picture: GreyPicture) -> None:
    for kind, pixels, suffix in (
        ("pictures", picture.grey, ".png"),
        ("masks", picture.lit.astype(np.uint8) * 255, ".png.png"),
    ):
        place = folder / kind / str(group)
        place.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(place / f"{name}{suffix}"), pixels)


def _run(folder: Path) -> dict[str, Any]:
    """The solver's result; its prints stay here, and so does whatever ends it."""
    threads = min(8, os.cpu_count() or 1)
    command = [sys.executable, "-m", "lightstage.motion.solver", str(folder), str(threads)]
    done = subprocess.run(
        command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )
    path = folder / "result.json"
    if done.returncode != 0 or not path.is_file():
        said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        raise MotionError(
            "cameras",
            found=f"COLMAP ended with {done.returncode}: {said[-1][:200] if said else 'no word'}",
            expected="cameras",
            hint="These photographs cannot be solved; measure the cameras and give --rig.",
        )
    return dict(read_json(path))


def _group_key(picture: GreyPicture, exif: Exif) -> tuple[Any, ...]:
    return picture.width_px, picture.height_px, picture.times, exif.model, exif.focal_mm


def _group(picture: GreyPicture, exif: Exif) -> dict[str, Any]:
    focal = _focal_px(picture, exif)
    return {
        "focal_px": None if focal is None else focal / picture.times,
        "cx_px": picture.width_px / 2 / picture.times,
        "cy_px": picture.height_px / 2 / picture.times,
    }


def _focal_px(picture: GreyPicture, exif: Exif) -> float | None:
    """What a photograph says of its focal length, in its own pixels; None where it says nothing."""
    if exif.focal_mm and exif.focal_plane_px_per_mm:
        return exif.focal_mm * exif.focal_plane_px_per_mm
    if exif.focal_35mm_mm:
        longer = max(picture.width_px, picture.height_px)
        return exif.focal_35mm_mm * longer / FULL_FRAME_MM
    return None


def _camera(name: str, picture: GreyPicture, exif: Exif, found: Mapping[str, Any]) -> Camera:
    focal, cx, cy, k1 = found["lens"]
    times = picture.times
    return Camera(
        id=name,
        serial=exif.serial or "",
        model=exif.model or "unknown",
        width_px=picture.width_px,
        height_px=picture.height_px,
        fx_px=times * focal,
        fy_px=times * focal,
        cx_px=times * cx,
        cy_px=times * cy,
        dist=(k1, 0.0, 0.0, 0.0, 0.0),
        cam_from_world=np.array(found["cam_from_world"], float),
    )
