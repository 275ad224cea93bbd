"""What becomes of a texture on the way to the people who use it."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from processing.colour import srgb_from_linear
from sim.scans.lps import linear_of

JPEG_QUALITY = 75
BLUR = 3 / 1536
"""Standard deviation, of the rows."""
BALANCE = np.array([1.1, 1.0, 0.9])
SIDE = np.array([0.7, 0.0, 0.7])
"""Toward the camera of a photograph from one side, head frame."""
SIDE_COSINE = 0.2

Flaw = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""A linear texture (rows, columns, 3), where it shows the head (rows, columns) and the mesh's
normals in the head frame (rows, columns, 3) to another texture; black is not photographed."""


def _jpeg(texture: np.ndarray, shown: np.ndarray, _: np.ndarray) -> np.ndarray:
    encoded = np.round(255 * srgb_from_linear(np.clip(texture, 0, 1))).astype(np.uint8)
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    packed = cv2.imencode(".jpg", encoded[..., ::-1], quality)[1]
    read = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))[..., ::-1]
    return linear_of(read.astype(np.float32) / 255) * shown[..., None]


def _blur(texture: np.ndarray, shown: np.ndarray, _: np.ndarray) -> np.ndarray:
    sigma = BLUR * len(texture)
    weight = cv2.GaussianBlur(shown.astype(np.float32), (0, 0), sigma)
    mean = cv2.GaussianBlur((texture * shown[..., None]).astype(np.float32), (0, 0), sigma)
    found: np.ndarray = mean / np.maximum(weight, 1e-3)[..., None] * shown[..., None]
    return found


def _one_side(texture: np.ndarray, _: np.ndarray, normal: np.ndarray) -> np.ndarray:
    toward = SIDE / np.linalg.norm(SIDE)
    found: np.ndarray = texture * (normal @ toward > SIDE_COSINE)[..., None]
    return found


def _times(factor: float | np.ndarray) -> Flaw:
    return lambda texture, _shown, _normal: texture * factor


FLAWS: dict[str, Flaw] = {
    "none": _times(1.0),
    f"JPEG, quality {JPEG_QUALITY}": _jpeg,
    "blur of 3 px at 1536 rows": _blur,
    "white balance off by 10 %": _times(BALANCE),
    "one side only": _one_side,
    "half a stop brighter": _times(2**0.5),
    "half a stop darker": _times(2**-0.5),
}
"""By the name of their row in the table."""
