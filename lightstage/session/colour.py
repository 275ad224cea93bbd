"""A colour calibration as a session carries it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lightstage.errors import FormatError
from lightstage.formats.files import read_json
from lightstage.formats.scale import chart_levels
from lightstage.rig import Rig

COLOUR_SCHEMA = "lightstage.colour/1"
COLOUR_PATH = "calibration/colour.json"


def read_colour(path: Path, rig: Rig) -> dict[str, Any]:
    """A colour calibration: for each camera a 3x3 matrix from raw to linear rgb.

    Raises:
        FormatError: another schema, a camera of the rig without a finite 3x3 matrix, or levels of
            the chart's light that do not fit the rig (formats.scale).
    """
    value = read_json(path, COLOUR_SCHEMA)
    cameras = value.get("cameras", {})
    for camera in rig.cameras:
        matrix = cameras.get(camera.id, {}).get("linear_from_raw")
        try:
            rows = [[float(cell) for cell in row] for row in matrix]
        except (TypeError, ValueError):
            rows = []
        whole = len(rows) == 3 and all(len(row) == 3 for row in rows)
        if not whole or not all(abs(cell) < 1e6 for row in rows for cell in row):
            raise FormatError(
                path,
                field=f"cameras.{camera.id}.linear_from_raw",
                found=repr(matrix),
                expected="3 rows of 3 finite numbers",
            )
    chart_levels(value, len(rig.lights), path)
    return dict(value)
