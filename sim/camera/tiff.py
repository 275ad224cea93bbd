"""A TIFF file of one uncompressed picture with an EXIF directory, byte by byte."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from fractions import Fraction

import numpy as np

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL = 1, 2, 3, 4, 5, 7, 10
EXIF_DIRECTORY, GPS_DIRECTORY = 34665, 34853
STRIP_OFFSETS, STRIP_BYTES = 273, 279
LARGEST_DENOMINATOR = 1_000_000
_LETTERS = {BYTE: "B", SHORT: "H", LONG: "I", UNDEFINED: "B"}

Tags = Mapping[int, tuple[int, object]]
"""Tag to its type and value: text, one number, bytes, or a sequence of numbers."""


def tiff_bytes(pixels: np.ndarray, tags: Tags, exif: Tags, gps: Tags | None = None) -> bytes:
    """A little-endian TIFF [TIFF1992] with one strip and an EXIF directory.

    Args:
        pixels: (h, w) uint16.
        tags: of the picture, all but the strip's place and the other directories'.
        exif: of the EXIF directory.
        gps: of the GPS directory; none is written where it is empty.
    """
    data = np.ascontiguousarray(pixels, "<u2").tobytes()
    first = 8
    own = dict(tags)
    # The places are of fixed size, so a first pass with zeros shows where everything will be.
    own |= {STRIP_OFFSETS: (LONG, 0), STRIP_BYTES: (LONG, len(data)), EXIF_DIRECTORY: (LONG, 0)}
    if gps:
        own[GPS_DIRECTORY] = (LONG, 0)
    exif_at = first + len(_directory(own, first))
    exif_part = _directory(exif, exif_at)
    gps_at = exif_at + len(exif_part)
    gps_part = _directory(gps, gps_at) if gps else b""
    own[EXIF_DIRECTORY] = (LONG, exif_at)
    own[STRIP_OFFSETS] = (LONG, gps_at + len(gps_part))
    if gps:
        own[GPS_DIRECTORY] = (LONG, gps_at)
    head = struct.pack("<2sHI", b"II", 42, first)
    return head + _directory(own, first) + exif_part + gps_part + data


def _directory(tags: Tags, at: int) -> bytes:
    """A directory that begins at byte `at`, with its longer values behind it."""
    place = at + 2 + 12 * len(tags) + 4
    entries, longer = struct.pack("<H", len(tags)), b""
    for tag, (kind, value) in sorted(tags.items()):
        count, packed = _packed(kind, value)
        if len(packed) > 4:
            entries += struct.pack("<HHII", tag, kind, count, place + len(longer))
            longer += packed + b"\0" * (len(packed) % 2)
        else:
            entries += struct.pack("<HHI", tag, kind, count) + packed.ljust(4, b"\0")
    return entries + struct.pack("<I", 0) + longer


def _packed(kind: int, value: object) -> tuple[int, bytes]:
    """How many values of a type, and their bytes."""
    if kind == ASCII:
        text = str(value).encode("ascii", "replace") + b"\0"
        return len(text), text
    values = np.atleast_1d(np.asarray(list(value) if isinstance(value, bytes) else value)).ravel()
    if kind in _LETTERS:
        return len(values), struct.pack(f"<{len(values)}{_LETTERS[kind]}", *map(int, values))
    letter = "i" if kind == SRATIONAL else "I"
    parts: list[int] = []
    for number in values:
        share = Fraction(float(number)).limit_denominator(LARGEST_DENOMINATOR)
        parts += [share.numerator, share.denominator]
    return len(values), struct.pack(f"<{len(parts)}{letter}", *parts)
