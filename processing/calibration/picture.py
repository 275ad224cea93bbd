"""A calibration photograph as its RAW file holds it: the mosaic, upright, black taken off."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rawpy

from lightstage.errors import FormatError
from lightstage.exif import read_exif
from lightstage.formats.flats import FlatField
from lightstage.formats.orientation import UNTURNED, Orientation, of_libraw
from lightstage.raw_errors import unreadable_raw
from processing.raw.clip import CLIP_SHARE
from processing.raw.hot_pixels import mend

MOST = 0.5
"""Share of a hot pixel's neighbours above which all of them count."""


@dataclasses.dataclass(frozen=True)
class Mosaic:
    """One RAW photograph, upright as rig.json's cameras are.

    Attributes:
        level: (h, w) float32 counts above black as a share of the white level; even sides.
        clipped: (h, w) bool, at the white level.
        channels: (2, 2) which of R G B (0, 1, 2) the top left four pixels see.
        exposure: seconds * ISO / f-number^2 from the file; None where it has none.
        orientation: by which what the sensor reads was brought upright.
    """

    level: np.ndarray
    clipped: np.ndarray
    channels: np.ndarray
    exposure: float | None
    orientation: Orientation = UNTURNED

    def upright(self, orientation: Orientation) -> Mosaic:
        """What the sensor reads, brought upright."""
        return self._moved(orientation.upright, orientation)

    def as_read(self) -> Mosaic:
        """The same in the rows and columns that the sensor reads."""
        return self._moved(self.orientation.as_read, UNTURNED)

    def _moved(self, move: Callable[[np.ndarray], np.ndarray], now: Orientation) -> Mosaic:
        return Mosaic(
            np.ascontiguousarray(move(self.level)),
            np.ascontiguousarray(move(self.clipped)),
            move(self.channels),
            self.exposure,
            now,
        )

    def cells(self) -> np.ndarray:
        """(h/2, w/2, 3) float32: each 2 x 2 cell is one pixel, its greens averaged."""
        height, width = self.level.shape
        out = np.zeros((height // 2, width // 2, 3), np.float32)
        counts = np.bincount(self.channels.ravel(), minlength=3)
        for place, channel in enumerate(self.channels.ravel()):
            out[..., channel] += self.level[place // 2 :: 2, place % 2 :: 2] / counts[channel]
        return out

    def clipped_cells(self) -> np.ndarray:
        """(h/2, w/2) bool, any pixel of the cell at the white level."""
        height, width = self.clipped.shape
        return np.asarray(self.clipped.reshape(height // 2, 2, width // 2, 2).any(axis=(1, 3)))


def read_mosaic(path: Path, clip_share: float = CLIP_SHARE) -> Mosaic:
    """Read a RAW's counts.

    Args:
        path: a file that LibRaw reads, with a 2 x 2 mosaic of one red, two green, one blue.
        clip_share: counts of at least this share of the white level (above black) are clipped.

    Raises:
        FormatError: missing, truncated, or another kind of file.
    """
    try:
        with rawpy.imread(str(path)) as raw:
            counts = raw.raw_image_visible
            colours = np.array(raw.raw_colors_visible[:2, :2])
            black, white = np.array(raw.black_level_per_channel, float), float(raw.white_level)
            letters = raw.color_desc.decode("ascii", "replace")
            channels = np.array([["RGB".find(letters[i]) for i in row] for row in colours])
            if counts.ndim != 2 or sorted(channels.ravel().tolist()) != [0, 1, 1, 2]:
                raise FormatError(
                    path,
                    found=f"{counts.ndim}-dimensional counts, colours {letters}",
                    expected="a mosaic of 2 x 2 pixels: one red, two green, one blue",
                )
            height, width = (side // 2 * 2 for side in counts.shape)
            level = counts[:height, :width].astype(np.float32)
            orientation = of_libraw(int(raw.sizes.flip))
        exposure = read_exif(path).exposure
    except (rawpy.LibRawError, OSError, AttributeError) as error:
        raise unreadable_raw(path, error) from None
    clipped = np.zeros(level.shape, bool)
    for place, own in enumerate(black[colours.ravel()]):
        part = (slice(place // 2, None, 2), slice(place % 2, None, 2))
        level[part] -= np.float32(own)
        clipped[part] = level[part] >= clip_share * (white - own)
    # One scale for all places, as decode has it: a count is as much light in each.
    level /= np.float32(max(white - black[colours.ravel()].max(), 1.0))
    return Mosaic(level, clipped, channels, exposure).upright(orientation)


def flattened(mosaic: Mosaic, field: FlatField | None) -> Mosaic:
    """A photograph with its black level and hot pixels mended and its vignetting undone.

    A hot pixel counts as clipped where most of its neighbours are.
    """
    if field is None:
        return mosaic
    read = mosaic.as_read()
    level, clipped = read.level.copy(), read.clipped.astype(np.float32)
    if field.black_offset is not None:
        for place, offset in enumerate(field.black_offset):
            level[place // 2 :: 2, place % 2 :: 2] -= np.float32(offset)
    mend(level, field.hot_pixels)
    mend(clipped, field.hot_pixels)
    height, width = level.shape
    level *= field.gain((height, width))
    made = dataclasses.replace(read, level=level, clipped=clipped > MOST)
    return made.upright(mosaic.orientation)
