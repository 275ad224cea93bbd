"""Colour: camera RGB to the session's linear RGB, and sRGB's curve for looking at pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import read_json

SCHEMA = "lightstage.colour/1"


def read_colour(path: Path, camera_ids: list[str]) -> dict[str, np.ndarray]:
    """Read a session's colour calibration.

    Args:
        path: JSON ``{"cameras": {ID: {"linear_from_raw": 3 x 3}}}``.
        camera_ids: cameras that must be in it.

    Returns:
        Camera id to (3, 3) linear_from_raw: rgb_linear = M @ (raw - black) / (white - black).

    Raises:
        FormatError: every camera that is missing or whose matrix is unusable, in one message.
    """
    value = read_json(path, SCHEMA)
    cameras = value.get("cameras")
    out: dict[str, np.ndarray] = {}
    bad = []
    for camera in camera_ids:
        try:
            matrix = np.array(cameras[camera]["linear_from_raw"], float).reshape(3, 3)
        except (KeyError, TypeError, ValueError):
            bad.append(camera)
            continue
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-12:
            bad.append(camera)
        out[camera] = matrix
    if bad:
        raise FormatError(
            path,
            field="cameras",
            found=f"no usable linear_from_raw for {', '.join(bad)}",
            expected="an invertible 3 x 3 matrix for each camera",
            hint="Photograph the grey card with these cameras again.",
        )
    return out


def srgb_from_linear(rgb_linear: np.ndarray) -> np.ndarray:
    """Encode for looking: IEC 61966-2-1, clipped to 0..1. Any shape.

    Source: [IEC61966].
    """
    value = np.clip(rgb_linear, 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(value, 0.0031308), 1 / 2.4) - 0.055
    return np.where(value <= 0.0031308, 12.92 * value, curve)


def linear_from_srgb(image_srgb: np.ndarray) -> np.ndarray:
    """Decode sRGB in 0..1 to linear, the inverse of `srgb_from_linear`. Any shape.

    Source: [IEC61966].
    """
    value = np.asarray(image_srgb)
    curve = np.power((np.maximum(value, 0.04045) + 0.055) / 1.055, 2.4)
    return np.where(value <= 0.04045, value / 12.92, curve)
