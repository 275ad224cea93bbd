"""A RAW photograph as the quick checks of calibration shots read it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import rawpy

from lightstage.errors import FormatError
from lightstage.raw_errors import unreadable_raw

_GREEN_KERNEL = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
"""Keeps a green pixel, and gives the others the mean of their four green neighbours."""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A photograph, black taken off, 1 = the sensor's white level.

    Attributes:
        rgb: (h // 2, w // 2, 3) float32; each cell of the mosaic is one pixel.
        green: (h, w) float32, interpolated.
        clipped: (h // 2, w // 2) whether any of a cell's pixels is at the white level.
    """

    rgb: np.ndarray
    green: np.ndarray
    clipped: np.ndarray

    def small(self, longest_px: int) -> np.ndarray:
        """(h, w) float32 green, its longer side at most `longest_px`."""
        factor = longest_px / max(self.green.shape)
        if factor >= 1:
            return self.green
        return cv2.resize(self.green, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def read_picture(path: Path) -> Picture:
    """Read a RAW's counts.

    Raises:
        FormatError: no RAW with a 2 x 2 colour mosaic that LibRaw reads.
    """
    try:
        with rawpy.imread(str(path)) as raw:
            counts = raw.raw_image_visible.astype(np.float32)
            # Rows and columns that the sensor hides may shift the mosaic.
            colours = np.array(raw.raw_colors_visible[:2, :2])
            black, white = np.array(raw.black_level_per_channel, float), float(raw.white_level)
            letters = raw.color_desc.decode("ascii", "replace")
    except (rawpy.LibRawError, OSError, AttributeError) as error:
        raise unreadable_raw(path, error) from None
    kinds = ["RGB".find(letters[int(index)]) for index in colours.ravel()]
    if counts.ndim != 2 or min(counts.shape) < 4 or sorted(kinds) != [0, 1, 1, 2]:
        raise FormatError(
            path,
            found=f"{counts.shape} counts, mosaic {letters}",
            expected="a colour mosaic of 2 x 2 pixels, one red, two green, one blue",
        )
    height, width = (side // 2 * 2 for side in counts.shape)
    counts = counts[:height, :width]
    level = np.empty_like(counts)
    rgb = np.zeros((height // 2, width // 2, 3), np.float32)
    clipped = np.zeros((height // 2, width // 2), bool)
    green = np.zeros_like(counts)
    # A count is as much light in each place: one scale for all.
    span = max(white - black[colours.ravel()].max(), 1.0)
    for place, kind in enumerate(kinds):
        part = (slice(place // 2, None, 2), slice(place % 2, None, 2))
        own = black[int(colours.ravel()[place])]
        level[part] = (counts[part] - own) / span
        rgb[..., kind] += level[part] / (2 if kind == 1 else 1)
        clipped |= counts[part] >= white
        if kind == 1:
            green[part] = level[part]
    green = cv2.filter2D(green, -1, _GREEN_KERNEL, borderType=cv2.BORDER_REFLECT_101)
    return Picture(rgb, green, clipped)
