"""Landmarks: iBUG's 68 [Sagonas2016] in pictures (landmarks.json) and on meshes (register-mesh).

In pictures there may be the 468 of MediaPipe's face mesh [Kartynnik2019] instead, for what asks for
them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.fields import MOST, is_number
from lightstage.formats.files import check_schema, read_json, write_json
from lightstage.rig import Rig

SCHEMA = "lightstage.landmarks/1"
LANDMARKS = "landmarks.json"
"""What a session calls its landmarks."""
SCHEME = "ibug68"
LEAST_PX = 2.0
"""No face of which points can be clicked is so small."""
COUNTS = {SCHEME: 68, "mediapipe468": 468}
"""Points of each scheme."""


def read_points_px(path: Path, scheme: str = SCHEME) -> dict[str, np.ndarray]:
    """Landmarks in a session's pictures.

    Args:
        path: the file.
        scheme: the one that is asked for, of `COUNTS`.

    Returns:
        Camera id to (n, 2) pixels, NaN where hidden.

    Raises:
        FormatError: another scheme, or not as many entries a camera as it has.
    """
    value = read_json(path, SCHEMA)
    _require_not_the_other(path, value, "points_px", "points_mm")
    points = value.get("points_px")
    if value.get("scheme") != scheme:
        raise FormatError(
            path,
            field="scheme",
            found=repr(value.get("scheme")),
            expected=repr(scheme),
            hint="`lightstage landmarks --scheme` writes either."
            if value.get("scheme") in tuple(COUNTS)
            else "",
        )
    if not isinstance(points, dict):
        found = "none" if points is None else type(points).__name__
        raise FormatError(path, field="points_px", found=found, expected="points by camera")
    return {
        camera: _array(path, f"points_px.{camera}", entry, 2, COUNTS[scheme])
        for camera, entry in points.items()
    }


def read_clicked(path: Path, rig: Rig) -> dict[str, np.ndarray]:
    """A session's landmarks.json: camera id to (68, 2) pixels, NaN where hidden.

    Args:
        path: the file.
        rig: the session's.

    Raises:
        FormatError: as `read_points_px`, or a camera that the rig lacks.
    """
    points_px = read_points_px(path)
    unknown = sorted(points_px.keys() - {camera.id for camera in rig.cameras})
    if unknown:
        raise FormatError(
            path, field="points_px", found=", ".join(unknown), expected="cameras of rig.json"
        )
    for camera, points in points_px.items():
        _require_in_photograph(path, camera, points, rig)
    return points_px


def _require_in_photograph(path: Path, camera: str, points: np.ndarray, rig: Rig) -> None:
    """Refuse points that are no pixels of a camera's photograph: shares of its sides, or far off.

    A detector may guess points of a face that the photograph cuts off, somewhat outside of it.
    """
    known = points[np.isfinite(points).all(axis=1)]
    if len(known) < 3:
        return
    size = np.array([rig.camera(camera).width_px, rig.camera(camera).height_px])
    field, expected = f"points_px.{camera}", f"pixels of {size[0]} x {size[1]}"
    if np.abs(known).max() <= LEAST_PX:
        raise FormatError(
            path,
            field=field,
            found=f"all points within {np.abs(known).max():.3g} px of the photograph's corner",
            expected=expected,
            hint="Are they shares of its width and height? Multiply them by these.",
        )
    middle = np.median(known, axis=0)
    if ((middle < 0) | (middle > size)).any():
        raise FormatError(
            path,
            field=field,
            found=f"most points around ({middle[0]:.4g}, {middle[1]:.4g}), outside",
            expected=expected,
            hint="Were they found in a larger copy of the photograph, or in one on its side?",
        )


def write_points_px(points_px: dict[str, np.ndarray], path: Path, scheme: str = SCHEME) -> Path:
    """Write landmarks.json, (n, 2) pixels by camera; NaN rows become null."""
    value = {camera: _entries(points) for camera, points in points_px.items()}
    return write_json(path, {"schema": SCHEMA, "scheme": scheme, "points_px": value})


def read_points_mm(path: Path) -> np.ndarray:
    """Landmarks on a mesh: (68, 3) mm, NaN where absent; FormatError as above."""
    value = read_json(path)
    given = value if isinstance(value, dict) else {}
    if "schema" in given:  # the file of another program may have none
        check_schema(path, value, SCHEMA)
    if given.get("scheme") != SCHEME:
        raise FormatError(
            path, field="scheme", found=repr(given.get("scheme")), expected=repr(SCHEME)
        )
    _require_not_the_other(path, value, "points_mm", "points_px")
    return _array(path, "points_mm", value.get("points_mm"), 3, COUNTS[SCHEME])


def write_points_mm(points_mm: np.ndarray, path: Path) -> Path:
    """Write (68, 3) landmarks of a mesh; NaN rows become null."""
    value = {"schema": SCHEMA, "scheme": SCHEME, "points_mm": _entries(points_mm)}
    return write_json(path, value)


_OF = {
    "points_px": "landmarks in a session's pictures, for `run` and `register`",
    "points_mm": "landmarks on a mesh, for `register-mesh`",
}


def _require_not_the_other(path: Path, value: dict[str, object], wanted: str, other: str) -> None:
    """Name which of the two kinds of landmarks a file holds in place of the wanted one."""
    if wanted not in value and other in value:
        raise FormatError(
            path,
            field=other,
            found=_OF[other],
            expected=f"{wanted}: {_OF[wanted]}",
            hint="docs/registration.md shows both files.",
        )


def _array(path: Path, field: str, entries: object, size: int, count: int) -> np.ndarray:
    if not isinstance(entries, list) or len(entries) != count:
        found = len(entries) if isinstance(entries, list) else type(entries).__name__
        raise FormatError(path, field=field, found=str(found), expected=f"{count} entries")
    out = np.full((count, size), np.nan)
    for index, entry in enumerate(entries):
        if entry is None:
            continue
        numbers = isinstance(entry, list) and all(map(is_number, entry))
        if not numbers or len(entry) != size:
            raise FormatError(
                path,
                field=f"{field}[{index}]",
                found=repr(entry),
                expected=f"{size} numbers of {MOST:g} at most, or null",
            )
        out[index] = entry
    return out


def _entries(points: np.ndarray) -> list[list[float] | None]:
    return [[round(float(c), 4) for c in row] if np.isfinite(row).all() else None for row in points]
