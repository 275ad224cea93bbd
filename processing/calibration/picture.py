"""A calibration photograph as its RAW file holds it: the mosaic, upright, black taken off."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import rawpy

from lightstage.errors import FormatError
from lightstage.exif import read_exif

_TURNS = {3: 2, 5: 1, 6: 3}
"""LibRaw's flip to quarter turns against the clock that bring the sensor's rows upright."""


@dataclasses.dataclass(frozen=True)
class Mosaic:
    """One RAW photograph, upright as rig.json's cameras are.

    Attributes:
        level: (h, w) float32 counts above black as a share of the white level; even sides.
        clipped: (h, w) bool, at the white level.
        channels: (2, 2) which of R G B (0, 1, 2) the top left four pixels see.
        exposure: seconds * ISO / f-number^2 as the file tells; None where it does not.
        turns: quarter turns against the clock by which what the sensor reads was brought upright.
    """

    level: np.ndarray
    clipped: np.ndarray
    channels: np.ndarray
    exposure: float | None
    turns: int = 0

    def turned(self, turns: int) -> Mosaic:
        """The same, turned by quarters against the clock."""
        return Mosaic(
            np.ascontiguousarray(np.rot90(self.level, turns)),
            np.ascontiguousarray(np.rot90(self.clipped, turns)),
            np.rot90(self.channels, turns),
            self.exposure,
            (self.turns + turns) % 4,
        )

    def as_read(self) -> Mosaic:
        """The same in the rows and columns that the sensor reads."""
        return self.turned(-self.turns) if self.turns else self

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


def read_mosaic(path: Path, clip_share: float = 1.0) -> Mosaic:
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
            turns = _TURNS.get(int(raw.sizes.flip), 0)
        exposure = exposure_of(path)
    except (rawpy.LibRawError, OSError, AttributeError) as error:
        raise FormatError(
            path, found=f"no readable RAW ({error})", expected="a photograph of the camera"
        ) from None
    for place, own in enumerate(black[colours.ravel()]):
        part = (slice(place // 2, None, 2), slice(place % 2, None, 2))
        level[part] = (level[part] - np.float32(own)) / np.float32(max(white - own, 1.0))
    mosaic = Mosaic(level, level >= clip_share, channels, exposure)
    return mosaic.turned(turns) if turns else mosaic


def exposure_of(path: Path) -> float | None:
    """Seconds * ISO / f-number^2 of a photograph as its headers tell; None where they do not.

    Raises:
        OSError: the file cannot be read.
    """
    exif = read_exif(path)
    seconds, iso, f_number = exif.exposure_s or 0, exif.iso or 0, exif.f_number or 0
    return seconds * iso / f_number**2 if min(seconds, iso, f_number) > 0 else None
