"""Camera RAW and DNG files to linear camera RGB, with what clipped marked."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import rawpy

from lightstage.errors import FormatError

PEDESTAL = 2048
"""Added before the demosaic, which takes unsigned 16-bit counts, so that noise below black is kept
and dark places do not turn brighter."""
SPAN = 65535 - 2 * PEDESTAL
OPENCV_CODES = {
    "RGGB": cv2.COLOR_BAYER_RGGB2RGB_EA,
    "GRBG": cv2.COLOR_BAYER_GRBG2RGB_EA,
    "BGGR": cv2.COLOR_BAYER_BGGR2RGB_EA,
    "GBRG": cv2.COLOR_BAYER_GBRG2RGB_EA,
}


@dataclasses.dataclass(frozen=True)
class RawPicture:
    """One decoded photograph.

    Attributes:
        rgb: (h, w, 3) float32 linear camera RGB, 0 = black level, 1 = white level.
        clipped: (h, w) bool, a count at the white level in the pixel or among those that the
            demosaic took its colours from.
        neutral_from_raw: (3,) per-channel gains that turn the camera's neutral (AsShotNeutral)
            grey, the green one 1.
    """

    rgb: np.ndarray
    clipped: np.ndarray
    neutral_from_raw: np.ndarray


def read_raw(path: Path, clip_share: float) -> RawPicture:
    """Decode a RAW file: black level, white level, edge-aware demosaic; no colour, no curve.

    Args:
        path: a file that LibRaw reads, with a 2 x 2 Bayer mosaic.
        clip_share: counts of at least this share of the white level (above black) are clipped.

    Raises:
        FormatError: missing, truncated, or no Bayer mosaic.
    """
    try:
        with rawpy.imread(str(path)) as raw:
            if raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2):
                raise FormatError(path, found="no 2 x 2 mosaic", expected="a Bayer sensor's RAW")
            counts = raw.raw_image_visible.copy()
            pattern = np.asarray(raw.raw_colors_visible[:2, :2])
            description = raw.color_desc.decode()
            black = np.array(raw.black_level_per_channel, float)
            white = float(raw.white_level)
            gains = np.array(raw.camera_whitebalance[:3], float)
    except (rawpy.LibRawError, OSError) as error:
        raise FormatError(
            path,
            found=_said(error),
            expected="a whole RAW or DNG file",
            hint="Is it truncated? Copy it from the camera again.",
        ) from None
    order = "".join(description[i] for i in pattern.ravel())
    if order not in OPENCV_CODES:
        raise FormatError(path, found=f"mosaic {order}", expected="RGGB, GRBG, BGGR or GBRG")
    mosaic, clipped = linear_mosaic(counts, black[pattern], white, clip_share)
    rgb = demosaic(mosaic, order)
    if not (np.isfinite(gains).all() and (gains > 0).all()):
        gains = np.ones(3)
    return RawPicture(rgb, clipped, gains / gains[1])


def linear_mosaic(
    counts: np.ndarray, black: np.ndarray, white: float, clip_share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Counts to 0 (black) .. 1 (white), and what clipped.

    Args:
        counts: (h, w) sensor counts.
        black: (2, 2) black levels of the mosaic's four places.
        white: white level.
        clip_share: see `read_raw`.

    Returns:
        (h, w) float32, and (h, w) bool that is true within two pixels of a clipped count.
    """
    height, width = counts.shape
    level = np.tile(black, ((height + 1) // 2, (width + 1) // 2))[:height, :width]
    mosaic = ((counts - level) / (white - level)).astype(np.float32)
    clipped = (mosaic >= clip_share).astype(np.uint8)
    return mosaic, cv2.dilate(clipped, np.ones((5, 5), np.uint8)) > 0


def demosaic(mosaic: np.ndarray, order: str) -> np.ndarray:
    """Edge-aware demosaic (OpenCV) of a linear mosaic.

    Args:
        mosaic: (h, w) float, 0 = black, 1 = white; values from -.03 to 1.03 are kept.
        order: the colours of the top-left 2 x 2 places in row order, such as RGGB.

    Returns:
        (h, w, 3) float32.
    """
    counts = np.clip(np.rint(mosaic * SPAN + PEDESTAL), 0, 65535).astype(np.uint16)
    rgb = cv2.cvtColor(counts, OPENCV_CODES[order])
    return (rgb.astype(np.float32) - PEDESTAL) / SPAN


def _said(error: Exception) -> str:
    said = error.args[0] if error.args else error
    return said.decode() if isinstance(said, bytes) else str(said)
