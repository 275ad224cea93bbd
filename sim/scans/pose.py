"""Where a scan sits: its unit, its landmarks, the motion into the head frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from lightstage.counting import counted
from lightstage.formats.fields import MOST, is_number
from lightstage.formats.files import read_json
from lightstage.formats.mesh import Mesh
from sim.errors import SimError
from sim.head.mesh import neutral_mesh
from sim.scans.checks import UNITS_MM
from sim.scans.lps import template_landmarks
from sim.scans.match import FEWEST_LANDMARKS
from sim.scans.scan_file import ScanFile

BOX_MM = 200.0
"""From the crown down: a head without its shoulders."""


def millimetres(scan: ScanFile, units: str | None) -> float:
    """Of one unit: the user's, else the format's, else 1; SimError when it is no unit."""
    if units is None:
        return 1.0 if scan.mm_per_unit is None else scan.mm_per_unit
    try:
        value = UNITS_MM[units] if units in UNITS_MM else float(units)
    except ValueError:
        value = 0.0
    if not (np.isfinite(value) and value > 0):
        raise SimError(
            "--units", found=repr(units), expected="mm, cm, m, or the millimetres of one unit"
        )
    return value


def read_landmarks(path: Path) -> tuple[np.ndarray, bool]:
    """A scan's landmarks.

    Args:
        path: JSON, scheme ibug68, with 68 ``points_mm`` (mm) or ``points`` (the scan's unit).

    Returns:
        (68, 3) in the scan's axes, NaN where unknown, and whether they are in mm.

    Raises:
        SimError: another scheme, not 68 entries, or too few known.
        FormatError: no readable JSON.
    """
    value = read_json(path)
    if not isinstance(value, dict) or value.get("scheme") != "ibug68":
        raise SimError(path, field="scheme", found="another", expected="'ibug68'")
    field = "points_mm" if "points_mm" in value else "points"
    entries = value.get(field)
    if not isinstance(entries, list) or len(entries) != 68:
        found = counted(len(entries), "entry", "entries") if isinstance(entries, list) else "none"
        raise SimError(path, field=field, found=found, expected="68 points or null")
    out = np.full((68, 3), np.nan)
    for index, entry in enumerate(entries):
        if entry is None:
            continue
        numbers = isinstance(entry, list) and all(map(is_number, entry))
        if not numbers or len(entry) != 3:
            raise SimError(
                path,
                field=f"{field}[{index}]",
                found=repr(entry),
                expected=f"3 numbers of {MOST:g} at most, or null",
            )
        out[index] = entry
    known = int(np.isfinite(out).all(axis=1).sum())
    if known < FEWEST_LANDMARKS:
        raise SimError(
            path,
            field=field,
            found=f"{known} known",
            expected=f"at least {FEWEST_LANDMARKS}",
            hint="Leave --landmarks away when there are none.",
        )
    return out, field == "points_mm"


def require_near(mesh: Mesh, marks: np.ndarray, where: Path, farthest_mm: float) -> None:
    """SimError when landmarks (68, 3) mm are off the surface by more than `farthest_mm`."""
    known = np.flatnonzero(np.isfinite(marks).all(axis=1))
    corners = mesh.vertices[mesh.faces]
    places = np.concatenate([mesh.vertices, corners.mean(axis=1)])
    away = np.asarray(cKDTree(places).query(marks[known])[0])
    # Between the samples of a coarse mesh a point may lie half an edge from the nearest.
    limit = farthest_mm + median_edge(mesh)
    far = known[away > limit]
    if len(far):
        raise SimError(
            where,
            field=f"landmark {far[0]}",
            found=f"{counted(len(far), 'landmark')} off the surface, by up to {away.max():.0f} mm",
            expected=f"at most {farthest_mm:g} mm",
            hint="points_mm are millimetres in the file's axes; points are in the file's unit.",
        )


def require_fit(
    marks: np.ndarray, head_from_file: np.ndarray, where: Path, largest_mm: float
) -> None:
    """SimError when landmarks (68, 3) mm, moved rigidly, fit a head's worse than this (rms)."""
    there = marks @ head_from_file[:, :3].T + head_from_file[:, 3]
    gap = np.linalg.norm(there - template_landmarks(), axis=1)
    rms = float(np.sqrt(np.nanmean(gap**2)))
    if rms > largest_mm:
        raise SimError(
            where,
            field="landmarks",
            found=f"{rms:.0f} mm rms from a head's",
            expected=f"at most {largest_mm:g} mm",
            hint="Is their order iBUG's (0 at the person's right ear), the file not mirrored?",
        )


def head_from_box(mesh: Mesh) -> np.ndarray:
    """(3, 4) shift that brings crown, front and middle of a head to our own's, without turning."""
    boxes = []
    for points in (mesh.vertices, neutral_mesh().vertices):
        top = points[points[:, 1] > points[:, 1].max() - BOX_MM]
        middle = (top[:, 0].min() + top[:, 0].max()) / 2
        boxes.append(np.array([middle, top[:, 1].max(), top[:, 2].max()]))
    return np.concatenate([np.eye(3), (boxes[1] - boxes[0])[:, None]], axis=1)


def median_edge(mesh: Mesh) -> float:
    """Median length of a triangle mesh's edges."""
    corners = mesh.vertices[mesh.faces]
    return float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
