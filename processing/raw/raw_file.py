"""Opening a camera's file: plain counts are mapped in place, else LibRaw unpacks them.

A Bayer mosaic keeps its counts. What has no 2 x 2 mosaic comes as three colours of each pixel: a
linear DNG's own, a Foveon's own, and for X-Trans LibRaw's demosaic without colour, curve or white
balance, on the same scale (values below black are lost there).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import rawpy

from lightstage.errors import FormatError
from lightstage.exif import read_exif
from lightstage.formats.orientation import Orientation, of_libraw
from lightstage.raw_errors import unreadable_raw
from processing.raw.plain_dng import map_plain_dng

LARGEST = 65535


@dataclasses.dataclass
class RawFile:
    """An opened photograph.

    Attributes:
        path: of the file.
        counts: (H', W') uint16 of a Bayer mosaic with its margins, or (h, w, 3) uint16 of others;
            valid until `close`.
        origin: row and column in `counts` of the picture's top left pixel.
        size: rows and columns as the sensor reads them.
        colours: (2, 2) which of R G B (0, 1, 2) the picture's top left places see; None where each
            pixel has three colours.
        black: (2, 2) counts without light of these places, or (3,) of R G B.
        white: count at which the sensor is full.
        neutral: (3,) gains that turn the camera's own white (AsShotNeutral) grey, green's 1.
        orientation: that brings the picture upright.
    """

    path: Path
    counts: np.ndarray
    origin: tuple[int, int]
    size: tuple[int, int]
    colours: np.ndarray | None
    black: np.ndarray
    white: float
    neutral: np.ndarray
    orientation: Orientation
    handle: Any = dataclasses.field(default=None, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the upright picture."""
        return self.orientation.shape(self.size)

    @property
    def span(self) -> float:
        """Counts from black to white: one scale for all places of a mosaic.

        A count is as much light in each, so what their blacks differ by must not scale them apart:
        white less the highest black [DNG14, "Mapping Raw Values to Linear Reference Values"].
        """
        return max(self.white - float(self.black.max()), 1.0)

    def close(self) -> None:
        """Give LibRaw's memory back; `counts` is freed then."""
        self.counts = np.zeros((0, 0), np.uint16)
        if self.handle is not None:
            self.handle.close()
            self.handle = None


def open_raw(path: Path) -> RawFile:
    """Open a file; other threads run meanwhile.

    Raises:
        FormatError: missing, truncated, or neither a mosaic of red, green and blue nor three
            colours of each pixel.
    """
    try:
        plain = map_plain_dng(path)
    except OSError as error:
        raise unreadable_raw(path, error) from None
    if plain is None:
        return unpack_raw(path)
    neutral = plain.neutral / plain.neutral[1]
    size = plain.counts.shape[0], plain.counts.shape[1]
    known = plain.colours, plain.black, plain.white, neutral, plain.orientation
    return RawFile(path, plain.counts, (0, 0), size, *known)


def unpack_raw(path: Path) -> RawFile:
    """Open a file with LibRaw, which unpacks all its counts; errors as of `open_raw`."""
    raw = rawpy.RawPy()
    try:
        raw.open_file(str(path))
        raw.unpack()
        return _opened(path, raw)
    # rawpy's `raw_pattern` raises NotImplementedError for a mosaic of colours that it does not
    # know: to the caller one more file that cannot be read.
    except (rawpy.LibRawError, OSError, NotImplementedError) as error:
        raw.close()
        raise unreadable_raw(path, error) from None
    except FormatError:
        raw.close()
        raise


def read_exposure(path: Path) -> float | None:
    """Seconds * ISO / f-number^2 from a file's header; None where one of them is missing.

    Raises:
        FormatError: it cannot be read.
    """
    try:
        return read_exif(path).exposure
    except OSError as error:
        raise unreadable_raw(path, error) from None


def _opened(path: Path, raw: Any) -> RawFile:
    letters = raw.color_desc.decode("ascii", "replace")
    sizes = raw.sizes
    size = int(sizes.height), int(sizes.width)
    blacks = np.array(raw.black_level_per_channel, float)
    gains = np.array(raw.camera_whitebalance[:3], float)
    if not (np.isfinite(gains).all() and (gains > 0).all()):
        gains = np.ones(3)
    black: np.ndarray
    counts, origin, colours, white = raw.raw_image, (0, 0), None, float(raw.white_level)
    pattern = raw.raw_pattern if raw.raw_type == rawpy.RawType.Flat else None
    if raw.num_colors != 3 or set(letters) - set("RGB"):
        raise FormatError(
            path,
            found=f"a sensor of {raw.num_colors} colours ({letters})",
            expected="one of red, green and blue",
        )
    if pattern is not None and pattern.shape == (2, 2):
        origin = int(sizes.top_margin), int(sizes.left_margin)
        places = [raw.raw_color(origin[0] + i // 2, origin[1] + i % 2) for i in range(4)]
        colours = np.array(["RGB".index(letters[place]) for place in places]).reshape(2, 2)
        black = blacks[places].reshape(2, 2)
        if sorted(colours.ravel().tolist()) != [0, 1, 1, 2] or colours[0, 0] == colours[1, 0]:
            raise FormatError(
                path,
                found=f"mosaic {colours.tolist()}",
                expected="one red, two green and one blue in 2 x 2",
            )
    elif raw.raw_type == rawpy.RawType.Stack:
        counts, black = raw.raw_image_visible[..., :3], blacks[[0, 1, 2]]
    else:
        counts, black, white = _developed(raw), np.zeros(3), float(LARGEST)
    if not white > black.max():
        raise FormatError(path, found=f"white level {white:g}", expected=f"above {black.max():g}")
    orientation = of_libraw(int(sizes.flip))
    gains = gains / gains[1]
    return RawFile(path, counts, origin, size, colours, black, white, gains, orientation, raw)


def _developed(raw: Any) -> np.ndarray:
    """LibRaw's demosaic: (h, w, 3) uint16, 0 = black level, `LARGEST` = white level."""
    return np.asarray(
        raw.postprocess(
            output_color=rawpy.ColorSpace.raw,
            gamma=(1, 1),
            no_auto_bright=True,
            user_wb=[1, 1, 1, 1],
            output_bps=16,
            user_flip=0,
            adjust_maximum_thr=0,
        )
    )
