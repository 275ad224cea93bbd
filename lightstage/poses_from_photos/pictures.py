"""Photographs as small grey pictures in which features can be found, and what of them is lit."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from lightstage.developed import developed_kind, read_developed
from lightstage.errors import FormatError, unreadable_file
from lightstage.formats.exr import read_exr
from lightstage.formats.orientation import of_libraw
from lightstage.photo_file import identify_file

LARGEST_PX = 2000
"""Longer side of the pictures that features are searched for in, at most."""
LIT_SHARE = 0.05
"""Share of the brightest twentieth's level: a brighter place, slightly blurred, shows something
lit."""


@dataclasses.dataclass(frozen=True)
class GreyPicture:
    """One photograph, made smaller.

    Attributes:
        grey: (h, w) uint8, local contrast evened out.
        lit: (h, w) bool, what is not background.
        times: pixels of the photograph a side of a pixel of `grey`.
        width_px, height_px: of the photograph, as the camera was held.
    """

    grey: np.ndarray
    lit: np.ndarray
    times: int
    width_px: int
    height_px: int


def read_grey(path: Path) -> GreyPicture:
    """Read a photograph of any kind that `import` takes for the feature detector.

    Raises:
        FormatError: unreadable, or of less than 64 pixels a side.
    """
    try:
        developed = read_developed(path) if developed_kind(path) is not None else None
        linear = developed is None and identify_file(path).encoding == "linear"
    except OSError as error:
        raise unreadable_file(path, error) from None
    if developed is not None or linear:
        image = read_exr(path) if developed is None else developed.rgb
        light = image if image.ndim == 2 else image.mean(axis=2)
        size, times = (image.shape[1], image.shape[0]), 1
    else:
        light, size, times = _read_mosaic(path)
    if min(size) < 64:
        raise FormatError(path, found=f"{size[0]} x {size[1]} pixels", expected="64 a side or more")
    light = np.nan_to_num(light.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    further = -(-max(light.shape) // LARGEST_PX)
    light = _cells(light, further)
    grey, lit = evened(light)
    return GreyPicture(grey, lit, times * further, *size)


def evened(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The 8-bit picture of (h, w) linear light, and which of its pixels are lit.

    Skin has little contrast, and shading much: each tile of the picture gets contrast of its own
    (CLAHE).
    """
    blurred = cv2.GaussianBlur(light, (0, 0), max(1.0, max(light.shape) / 500))
    lit = blurred > LIT_SHARE * float(np.percentile(blurred, 95))
    scale = float(np.percentile(light[lit], 99)) if lit.any() else 0.0
    if not scale > 0:
        return np.zeros(light.shape, np.uint8), np.zeros(light.shape, bool)
    encoded = np.round(np.clip(light / scale, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)
    even = cv2.createCLAHE(clipLimit=3.0, tileGridSize=(8, 8))
    return np.asarray(even.apply(encoded)), lit


def _read_mosaic(path: Path) -> tuple[np.ndarray, tuple[int, int], int]:
    """Mean counts above black of a mosaic's cells, upright; size and cell's side in pixels."""
    import rawpy

    from lightstage.raw_errors import unreadable_raw

    try:
        with rawpy.imread(str(path)) as raw:
            counts = raw.raw_image_visible.astype(np.float32)
            black = float(np.mean(raw.black_level_per_channel))
            pattern, flip = raw.raw_pattern, int(raw.sizes.flip)
    except (rawpy.LibRawError, ValueError, OSError) as error:
        raise unreadable_raw(path, error) from None
    # A cell holds the mosaic's whole period, so that its mean does not depend on its place.
    times = 1
    if counts.ndim == 3:
        counts = counts[..., :3].mean(axis=2)
    elif pattern is not None:
        times = pattern.shape[0]
    turned = of_libraw(flip).upright(counts - black)
    size = turned.shape[1], turned.shape[0]
    return _cells(np.ascontiguousarray(turned), times), size, times


def _cells(light: np.ndarray, times: int) -> np.ndarray:
    """Means over whole cells of `times` pixels a side, from the top left."""
    height, width = (side // times for side in light.shape)
    cut = light[: height * times, : width * times]
    return np.asarray(cut.reshape(height, times, width, times).mean(axis=(1, 3)))
