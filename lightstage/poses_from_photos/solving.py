"""Small pictures to cameras in COLMAP's own units: the process that solves, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.counting import counted
from lightstage.errors import LightstageError, MotionError, one_error
from lightstage.exif import Exif
from lightstage.formats.files import read_json
from lightstage.poses_from_photos.lenses import OPEN, Lens, TypedLens, shared_lenses
from lightstage.poses_from_photos.pictures import GreyPicture
from lightstage.rig import Camera

MIN_CAMERAS = 3
"""Two photographs do not determine a focal length."""
MIN_MATCHES = 15
"""Verified matches that a camera must have with another one."""
MIN_POINTS = 20
FLAT, NEAREST = 0.02, 0.9
"""Share of a scene's extent below which it is flat; and the share of its points that is used."""
MAX_RESIDUAL_SHARE = 0.002
"""Share of a picture's longer side: mean residual of a camera's points above which it is refused.
"""


@dataclasses.dataclass(frozen=True)
class Doubted:
    """Lenses that explain the photographs better than those that were given.

    Attributes:
        lenses: who would share a focal length; `focal_px` is what it would be.
        told_px, apart_px: mean residuals with the given lenses, and with these.
    """

    lenses: list[Lens]
    told_px: float
    apart_px: float

    @property
    def odd(self) -> list[Lens]:
        """All but the one that most cameras share."""
        largest = max(self.lenses, key=lambda lens: len(lens.cameras))
        return [lens for lens in self.lenses if lens is not largest]


@dataclasses.dataclass(frozen=True)
class Solved:
    """Cameras that fit one another.

    Attributes:
        cameras: id to camera; the world and its unit are COLMAP's own.
        points: (n, 3) of the surface, in the same world.
        residual_px: id to mean residual of its points, pixels of its photographs.
        seen: id to how many points it sees.
        matches: id to verified matches with all others.
        told_px: id to the focal length that a file or its photograph gives, its own pixels; None
            where neither does.
        lenses: who shares a focal length, as found; `focal_px` is what it came to.
        bent: id to the share by which its lens would move a corner, where that is no lens and
            distortion was left out.
        together_px: mean residual with one lens for cameras of which nobody gave who shares one;
            None where that was taken.
        doubted: lenses that explain the photographs better than those that were given; None where
            none do.
    """

    cameras: dict[str, Camera]
    points: np.ndarray
    residual_px: dict[str, float]
    seen: dict[str, int]
    matches: dict[str, int]
    told_px: dict[str, float | None]
    lenses: list[Lens]
    bent: dict[str, float]
    together_px: float | None
    doubted: Doubted | None


def solve(
    pictures: Mapping[str, GreyPicture],
    exifs: Mapping[str, Exif],
    typed: Collection[TypedLens] = (),
) -> Solved:
    """Find cameras from one photograph of each.

    Who shares a focal length and a term of distortion is given by `typed` or by the photographs
    (`lenses.shared_lenses`); where neither has it, one focal length is tried against several.
    The principal point is the picture's middle.

    Args:
        pictures: by camera id.
        exifs: each photograph's own fields.
        typed: lenses.json.

    Raises:
        MotionError: naming every camera that has too few matches, no place among the others or a
            residual too large; or that nothing could be solved; or lenses.json of other cameras.
    """
    names = list(pictures)
    if len(names) < MIN_CAMERAS:
        raise MotionError(
            "cameras",
            found=f"photographs of {', '.join(names) or 'none'}",
            expected=f"{MIN_CAMERAS} cameras at least",
            hint="Two photographs do not determine a focal length; give --rig.",
        )
    begun = shared_lenses(pictures, exifs, typed)
    with tempfile.TemporaryDirectory(prefix="lightstage-motion-") as place:
        folder = Path(place)
        for name, picture in pictures.items():
            _put(folder, name, picture)
        job = {"lenses": [_job(lens, pictures[lens.cameras[0]]) for lens in begun]}
        (folder / "job.json").write_text(json.dumps(job))
        result = _run(folder)
    matches = dict.fromkeys(names, 0)
    best = dict.fromkeys(names, 0)
    for one, other, count in result["pairs"]:
        for name in (one, other):
            matches[name] += count
            best[name] = max(best[name], count)
    found = result["cameras"]
    times = max(picture.times for picture in pictures.values())
    doubted = _doubted(result.get("doubted"), times)
    _refuse(names, best, found, pictures, doubted)
    points = np.array(result["points"], float).reshape(-1, 3)
    _refuse_flat(points)
    cameras = {name: _camera(name, pictures[name], exifs[name], found[name]) for name in names}
    by = {name: lens.by for lens in begun for name in lens.cameras}
    return Solved(
        cameras,
        points,
        {name: pictures[name].times * found[name]["residual_px"] for name in names},
        {name: found[name]["points"] for name in names},
        matches,
        {name: lens.focal_px for lens in begun for name in lens.cameras},
        [
            Lens(tuple(shared), cameras[shared[0]].fx_px, by[shared[0]])
            for shared in result["lenses"]
        ],
        result["bent"],
        None if result["together_px"] is None else times * result["together_px"],
        doubted,
    )


def _doubted(found: Mapping[str, Any] | None, times: int) -> Doubted | None:
    if found is None:
        return None
    groups = zip(found["lenses"], found["focal_px"], strict=True)
    return Doubted(
        [Lens(tuple(names), times * focal, OPEN) for names, focal in groups],
        times * found["together_px"],
        times * found["apart_px"],
    )


def _refuse(
    names: list[str],
    best: Mapping[str, int],
    found: Mapping[str, Any],
    pictures: Mapping[str, GreyPicture],
    doubted: Doubted | None,
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
                    _own_lens(name, doubted) or "Did the subject move between the photographs?",
                )
    if problems:
        raise one_error(problems)


def _refuse_flat(points: np.ndarray) -> None:
    """MotionError where points (n, 3) are in a plane, which determines no focal length."""
    off = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    most = points[off <= np.quantile(off, NEAREST)]
    extent = np.linalg.svd(most - most.mean(axis=0), compute_uv=False)
    if extent[2] < FLAT * extent[0]:
        raise MotionError(
            "cameras",
            found="photographs of something flat, such as a wall: its points are within "
            f"{100 * extent[2] / extent[0]:.1f} % of their extent from a plane",
            expected=f"a subject with depth, {100 * FLAT:.0f} % at least",
            hint="What is flat determines no focal length. Photograph a person or a thing, and "
            "keep the background dark: what is lit counts.",
        )


def _own_lens(name: str, doubted: Doubted | None) -> str:
    """What to do where a camera does not share the lens that it is given as sharing; else empty."""
    for lens in () if doubted is None else doubted.odd:
        if name in lens.cameras:
            return (
                f"It bends the others: it does not share the focal length that EXIF or --lenses "
                f"gives, but fits with {lens.focal_px:.0f} px. Give the lenses in --lenses FILE."
            )
    return ""


def _put(folder: Path, name: str, picture: GreyPicture) -> None:
    for kind, pixels, suffix in (
        ("pictures", picture.grey, ".png"),
        ("masks", picture.lit.astype(np.uint8) * 255, ".png.png"),
    ):
        place = folder / kind
        place.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(place / f"{name}{suffix}"), pixels)


def _run(folder: Path) -> dict[str, Any]:
    """The solver's result; its prints stay here, and so does whatever ends it."""
    threads = min(8, os.cpu_count() or 1)
    command = [
        sys.executable,
        "-m",
        "lightstage.poses_from_photos.solver",
        str(folder),
        str(threads),
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )
    path = folder / "result.json"
    if done.returncode != 0 or not path.is_file():
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        raise MotionError(
            "cameras",
            found=f"COLMAP ended with {done.returncode}: {lines[-1][:200] if lines else 'no word'}",
            expected="cameras",
            hint="These photographs cannot be solved; measure the cameras and give --rig.",
        )
    return dict(read_json(path))


def _job(lens: Lens, picture: GreyPicture) -> dict[str, Any]:
    """A lens in pixels of the smaller pictures, as `solver` takes it."""
    focal = lens.focal_px
    return {
        "cameras": lens.cameras,
        "focal_px": None if focal is None else focal / picture.times,
        "open": lens.by == OPEN,
        "centre_px": [
            picture.width_px / 2 / picture.times,
            picture.height_px / 2 / picture.times,
        ],
    }


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
