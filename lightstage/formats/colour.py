"""The numbers of colour.json (lightstage.colour/1): each camera's way from counts to linear rgb."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.fields import array_of

SCHEMA = "lightstage.colour/1"
LEAST_DETERMINANT = 1e-12


class ColourNumbers(NamedTuple):
    """What colour.json has of one camera.

    Attributes:
        matrix: (3, 3) ``linear_from_raw``, which has an inverse.
        root_polynomial: (3, 6), or None.
        exposure: seconds * ISO / f-number^2, above 0, or None.
    """

    matrix: np.ndarray
    root_polynomial: np.ndarray | None
    exposure: float | None


def colour_numbers(
    value: Mapping[str, Any], camera_ids: Sequence[str], path: Path
) -> dict[str, ColourNumbers]:
    """The numbers of some cameras.

    Args:
        value: of the file.
        camera_ids: cameras that must be in it.
        path: of the file, for errors.

    Raises:
        FormatError: every camera that is missing or whose numbers are unusable, in one message.
    """
    cameras: Any = value.get("cameras")
    out: dict[str, ColourNumbers] = {}
    bad = []
    for camera in camera_ids:
        try:
            out[camera] = _numbers(cameras[camera])
        except (KeyError, TypeError, ValueError):
            bad.append(camera)
    if bad:
        raise FormatError(
            path,
            field="cameras",
            found=f"no usable linear_from_raw for {', '.join(bad)}",
            expected="an invertible 3 x 3 matrix for each camera; root_polynomial, where there is "
            "one, 3 x 6 finite numbers; exposure above 0",
            hint="Photograph the colour chart with these cameras again.",
        )
    return out


def _numbers(entry: Mapping[str, Any]) -> ColourNumbers:
    """One camera's numbers; ValueError, TypeError or KeyError where they are unusable."""
    matrix = array_of(entry["linear_from_raw"], 3, 3)
    bent, exposure = entry.get("root_polynomial"), entry.get("exposure")
    terms = None if bent is None else array_of(bent, 3, 6)
    light = None if exposure is None else float(array_of(exposure))
    if abs(np.linalg.det(matrix)) < LEAST_DETERMINANT:
        raise ValueError("no inverse")
    if light is not None and not 0 < light < np.inf:
        raise ValueError("no exposure")
    return ColourNumbers(matrix, terms, light)
