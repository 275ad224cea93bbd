"""Photographs taken elsewhere, opened: read to their end once, so that no later stage is surprised.

A RAW is unpacked, an OpenEXR read; what a later stage would refuse is refused here, where the file
has its own name still.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from lightstage.counting import counted
from lightstage.developed import Developed, developed_kind, read_developed
from lightstage.errors import FormatError, unreadable_file
from lightstage.formats.exr import other_primaries, read_exr
from lightstage.formats.orientation import of_libraw
from lightstage.photo_file import identify_file

LEAST_PX = 8
LEAST_BITS_PER_PX = 0.02
"""No compression keeps counts in less; LibRaw gives zeros for what a cut RAW does not hold."""


@dataclasses.dataclass(frozen=True)
class Opened:
    """A photograph that could be read.

    Attributes:
        size_px: width and height, upright.
        encoding: ``raw``, ``linear``, or ``developed`` for a JPEG, PNG or TIFF.
        developed: of such a one, its light.
    """

    size_px: tuple[int, int]
    encoding: str
    developed: Developed | None = None


def open_photograph(path: Path) -> Opened:
    """Open a photograph and read all of it.

    Raises:
        FormatError: damaged; of a format that LibRaw does not know; no photograph; without three
            colours, or with others than sRGB's; with NaN; of fewer than 8 x 8 pixels.
    """
    try:
        if developed_kind(path) is not None:
            developed = read_developed(path)
            height, width = developed.rgb.shape[:2]
            return _large_enough(path, Opened((width, height), "developed", developed))
        encoding = identify_file(path).encoding
    except OSError as error:
        raise unreadable_file(path, error) from None
    size = _raw_size(path) if encoding == "raw" else _linear_size(path)
    return _large_enough(path, Opened(size, encoding))


def _large_enough(path: Path, opened: Opened) -> Opened:
    width, height = opened.size_px
    if min(width, height) < LEAST_PX:
        raise FormatError(
            path,
            found=f"{width} x {height} pixels",
            expected=f"a photograph of {LEAST_PX} x {LEAST_PX} or more",
        )
    return opened


def _linear_size(path: Path) -> tuple[int, int]:
    image = read_exr(path, finite=True)
    if image.ndim != 3:
        raise FormatError(
            path, found="one channel", expected="R G B", hint="Export the photograph in colour."
        )
    if primaries := other_primaries(path):
        raise FormatError(
            path,
            field="chromaticities",
            found=primaries,
            expected="those of sRGB (Rec. 709): maps are linear sRGB",
            hint="Convert the photographs to linear sRGB, or export them so.",
        )
    return image.shape[1], image.shape[0]


def _raw_size(path: Path) -> tuple[int, int]:
    """Width and height of a RAW, upright, once LibRaw has unpacked it."""
    import rawpy

    from lightstage.raw_errors import unreadable_raw

    try:
        with rawpy.imread(str(path)) as raw:
            counts = raw.raw_image_visible  # unpacks
            colours, letters = raw.num_colors, raw.color_desc.decode("ascii", "replace")
            rows, columns = of_libraw(raw.sizes.flip).shape((raw.sizes.height, raw.sizes.width))
    except (rawpy.LibRawError, ValueError, OSError, NotImplementedError) as error:
        raise unreadable_raw(path, error) from None
    size = path.stat().st_size
    if 8 * size < LEAST_BITS_PER_PX * columns * rows:
        raise FormatError(
            path,
            found=f"{counted(size, 'byte')} for {columns} x {rows} pixels",
            expected="the pixels' counts too",
            hint="The file is truncated; download or copy it again.",
        )
    if colours != 3 or set(letters) - set("RGB") or counts.size == 0:
        raise FormatError(
            path,
            found=f"a sensor of {colours} colours ({letters})",
            expected="one of red, green and blue",
        )
    return columns, rows
