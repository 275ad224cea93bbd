"""Points that a person clicked in several photographs: their files, and where they are in space."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lightstage.errors import FormatError, MotionError
from lightstage.formats.fields import is_number
from lightstage.formats.files import read_json
from lightstage.formats.landmarks import SCHEMA as LANDMARKS_SCHEMA
from lightstage.formats.landmarks import read_points_px
from lightstage.nearest_point import nearest_equations
from lightstage.rig import Camera

SCHEMA = "lightstage.points/1"
MAX_CLICK_SHARE = 0.02
"""Share of a picture's longer side: a click farther from where the other clicks put its point is
wrong."""

Clicks = dict[str, dict[str, np.ndarray]]
"""Point's name to camera's id to (2,) pixels."""


@dataclasses.dataclass(frozen=True)
class Placed:
    """A clicked point in space.

    Attributes:
        position: (3,) in the cameras' world.
        residual_px: median distance of the clicks from it.
    """

    position: np.ndarray
    residual_px: float


def read_clicks(path: Path) -> Clicks:
    """Clicked points of points.json, or the landmarks of landmarks.json, which are called 0 to 67.

    Raises:
        FormatError: another schema, or not two numbers a click.
    """
    value = read_json(path)
    if isinstance(value, dict) and str(value.get("schema", "")).startswith(
        LANDMARKS_SCHEMA.split("/")[0]
    ):
        out: Clicks = {}
        for camera, points in read_points_px(path).items():
            for index in np.flatnonzero(np.isfinite(points).all(axis=1)):
                out.setdefault(str(index), {})[camera] = points[index]
        return out
    value = read_json(path, SCHEMA)
    entries = value.get("points_px")
    if not isinstance(entries, dict):
        raise FormatError(
            path,
            field="points_px",
            found=type(entries).__name__,
            expected='{"cam0": {"left": [x, y]}}',
        )
    found: Clicks = {}
    for camera, named in entries.items():
        for name, pixel in (named if isinstance(named, dict) else {"?": None}).items():
            given = pixel if isinstance(pixel, list) else []
            if len(given) != 2 or not all(map(is_number, given)):
                raise FormatError(
                    path,
                    field=f"points_px.{camera}.{name}",
                    found=repr(pixel),
                    expected="two finite numbers",
                )
            found.setdefault(name, {})[camera] = np.array(given, float)
    return found


def place(name: str, clicks: Mapping[str, np.ndarray], cameras: Mapping[str, Camera]) -> Placed:
    """Where a point is that was clicked in several photographs: nearest to all its rays.

    Args:
        name: for errors.
        clicks: camera's id to (2,) pixels, the top-left pixel's centre at (0.5, 0.5).
        cameras: by id.

    Raises:
        MotionError: clicked in fewer than two of these cameras' photographs, behind one of them,
            or a click that is far from where the others put the point.
    """
    known = {camera: pixel for camera, pixel in clicks.items() if camera in cameras}
    if len(known) < 2:
        raise MotionError(
            f"point {name}",
            found=f"clicked in {', '.join(known) or 'no photograph of these cameras'}",
            expected="the photographs of two cameras at least",
        )
    centres = np.array([cameras[camera].centre_mm for camera in known])
    rays = [cameras[camera].rays_through(*pixel[:, None])[0] for camera, pixel in known.items()]
    moment, right = nearest_equations(centres, np.array(rays))
    # Rays that are nearly parallel meet nowhere in particular: the smaller eigenvalue is their
    # angle squared, half a degree here.
    if np.linalg.eigvalsh(moment)[0] < 1e-4:
        raise MotionError(
            f"point {name}",
            found=f"clicked in {', '.join(known)}, which show it from one direction",
            expected="photographs from different directions",
        )
    position = np.linalg.solve(moment, right)
    misses = {}
    for camera, pixel in known.items():
        shown, _ = cameras[camera].project(position[None])
        misses[camera] = float(np.linalg.norm(shown[0] - pixel))
    wrong = [
        f"{camera} ({'behind it' if np.isnan(miss) else f'{miss:.0f} px'})"
        for camera, miss in misses.items()
        if not miss <= MAX_CLICK_SHARE * max(cameras[camera].width_px, cameras[camera].height_px)
    ]
    if wrong:
        raise MotionError(
            f"point {name}",
            found="clicks that do not meet, off by " + ", ".join(wrong),
            expected="the same place clicked in every photograph",
        )
    return Placed(position, float(np.median(list(misses.values()))))
