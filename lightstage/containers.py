"""Parts of the files that hold photographs: boxes of a CR3, segments of a JPEG, chunks of a PNG."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from lightstage.tiff import Reader

MOST_PARTS = 64
JPEG_HEAD = b"\xff\xd8\xff"
PNG_HEAD = b"\x89PNG\r\n\x1a\n"
FRAMES = (0xC0, 0xC1, 0xC2, 0xC3, *range(0xC5, 0xC8), *range(0xC9, 0xCC), *range(0xCD, 0xD0))
"""Markers of a JPEG's frame headers, which give bits, size and components [JPEG1992]."""


def boxes(reader: Reader, place: int, end: int | None) -> Iterator[tuple[bytes, int, int]]:
    """Boxes in a part of a file: kind, where the content begins, its size."""
    for _ in range(MOST_PARTS):
        head = reader.bytes_at(place, 16) if end is None or place < end else b""
        if len(head) < 8:
            return
        size, kind = struct.unpack(">I4s", head[:8])
        start = 8
        if size == 1 and len(head) == 16:
            (size,) = struct.unpack(">Q", head[8:])
            start = 16
        if size < start:
            return
        yield kind, place + start, size - start
        place += size


def segments(reader: Reader, place: int) -> Iterator[tuple[int, int, int]]:
    """Segments of a JPEG's header from a byte on: marker, where the content begins, its size."""
    for _ in range(16 * MOST_PARTS):
        head = reader.bytes_at(place, 4)
        if len(head) < 4 or head[0] != 0xFF or head[1] in (0xD9, 0xDA):
            return
        (size,) = struct.unpack(">H", head[2:])
        yield head[1], place + 4, max(size - 2, 0)
        place += 2 + size


def chunks(reader: Reader) -> Iterator[tuple[bytes, int, int]]:
    """Chunks of a PNG before its picture: kind, where the content begins, its size."""
    place = len(PNG_HEAD)
    for _ in range(16 * MOST_PARTS):
        head = reader.bytes_at(place, 8)
        if len(head) < 8:
            return
        size, kind = struct.unpack(">I4s", head)
        if kind in (b"IDAT", b"IEND"):
            return
        yield kind, place + 8, size
        place += 12 + size
