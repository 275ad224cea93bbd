"""A photograph's file: linear light, and the focal length that it states."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from learning.errors import MapsError
from lightstage.developed import read_developed
from lightstage.exif import FILM_RANGE_MM, film_focal_px, read_exif
from lightstage.formats.exr import read_exr

LARGEST_PX = 6000
"""Longer side above which a photograph is made smaller: a texture shows no more."""
SMALLEST_PX = 64
"""Shorter side of a photograph at least."""


@dataclasses.dataclass(frozen=True)
class PhotoFile:
    """What a file holds.

    Attributes:
        rgb_linear: (h, w, 3) float32, upright.
        focal_px: focal length in its pixels, or None.
        scale: its pixels over the file's, below 1 where it was made smaller.
    """

    rgb_linear: np.ndarray
    focal_px: float | None
    scale: float


def read_photograph(path: Path, film_mm: float | None = None) -> PhotoFile:
    """Read a JPEG, PNG or TIFF (its profile or sRGB is undone; grey too), or a linear OpenEXR.

    Args:
        path: the file.
        film_mm: 35 mm equivalent of the focal length, in place of what the file states.

    Raises:
        FormatError: see `read_developed` and `read_exr`.
        MapsError: a picture too small to hold a face, or a focal length that is none.
    """
    if path.is_dir():
        raise MapsError(path, found="a folder", expected="a photograph")
    if path.suffix.lower() == ".exr":
        rgb = read_exr(path, finite=True)
        if rgb.ndim != 3:
            raise MapsError(path, found="one channel", expected="R G B")
    else:
        rgb = read_developed(path, grey=True).rgb
    height, width = rgb.shape[:2]
    if min(height, width) < SMALLEST_PX:
        raise MapsError(
            path,
            found=f"{width} x {height} px",
            expected=f"{SMALLEST_PX} px a side at least",
        )
    longer = max(height, width)
    scale = min(1.0, LARGEST_PX / longer)
    if scale < 1:
        size = (round(width * scale), round(height * scale))
        rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    focal = _focal(path, width, height, film_mm)
    return PhotoFile(
        np.ascontiguousarray(rgb, np.float32), None if focal is None else focal * scale, scale
    )


def _focal(path: Path, width_px: int, height_px: int, film_mm: float | None) -> float | None:
    """Focal length in pixels of the file as it is; None where nothing states it."""
    if film_mm is None:
        return read_exif(path).focal_px(width_px, height_px)
    least, most = FILM_RANGE_MM
    if not least <= film_mm <= most:
        raise MapsError("--focal-35mm", found=f"{film_mm:g}", expected=f"{least:g} to {most:g} mm")
    return film_focal_px(film_mm, width_px, height_px)
