"""Directories of a TIFF-like file, read in place: headers only, never the picture.

Damaged offsets lead nowhere: what cannot be read is left out, and the count of directories, of
entries and of bytes read is limited, so that no file makes a reader slow.
"""

from __future__ import annotations

import dataclasses
import errno
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import BinaryIO, NamedTuple, TypeVar

from lightstage.printable import printable

SUB_IFDS, EXIF_IFD, GPS_IFD = 330, 34665, 34853
MAX_DIRECTORIES = 32
MAX_ENTRIES = 2000
MAX_VALUE_BYTES = 1 << 18
MAX_READ_BYTES = 1 << 22

MAGIC = (42, 0x55, 0x4F52, 0x5352)
"""TIFF's own number, and what Panasonic and Olympus write in its place."""

_LETTERS = {1: "B", 2: "s", 3: "H", 4: "I", 6: "b", 7: "s", 8: "h", 9: "i", 11: "f", 12: "d"}
_LETTERS |= {13: "I"}
_PAIRS = {5: "I", 10: "i"}

Found = TypeVar("Found")
Value = bytes | tuple[float, ...]
"""Text and undefined bytes as bytes; whole numbers, and quotients of rationals (NaN of x/0)."""


class Entry(NamedTuple):
    """One entry of a directory.

    Attributes:
        tag: number.
        type: of its values [TIFF1992].
        length: how many values.
        place: byte at which the entry's last four bytes are: the value, or where a longer one is.
        inline: these four bytes.
    """

    tag: int
    type: int
    length: int
    place: int
    inline: bytes

    @property
    def each(self) -> int:
        """Bytes of one value; 0 of an unknown type."""
        if self.type in _PAIRS:
            return 8
        return struct.calcsize("<" + _LETTERS[self.type]) if self.type in _LETTERS else 0

    @property
    def size(self) -> int:
        """Bytes of all values."""
        return self.each * self.length

    def value_place(self, order: str) -> int:
        """Byte at which the value begins."""
        return self.place if self.size <= 4 else int(struct.unpack(order + "I", self.inline)[0])


@dataclasses.dataclass(frozen=True)
class Directory:
    """One directory.

    Attributes:
        kind: ``picture`` (the chain from the header, and SubIFDs), ``exif`` or ``gps``.
        tags: number to its value.
        places: number to the byte of the file at which its value begins.
    """

    kind: str
    tags: dict[int, Value]
    places: dict[int, int]

    def text(self, tag: int) -> str:
        """A tag as printable text without padding; empty where there is none."""
        value = self.tags.get(tag, b"")
        if not isinstance(value, bytes):
            return ""
        return printable(value.decode("utf-8", "replace").replace("\0", " "))

    def number(self, tag: int) -> float | None:
        """A tag's first number; None where there is none or it is not finite."""
        value = self.tags.get(tag)
        if not isinstance(value, tuple) or not value or not abs(value[0]) < float("inf"):
            return None
        return value[0]


class Reader:
    """Reads few bytes here and there.

    Args:
        file: seekable.
        base: the TIFF header's place in it.
    """

    def __init__(self, file: BinaryIO, base: int = 0) -> None:
        self.base = base
        self._file = file
        self._left = [MAX_READ_BYTES]

    def bytes_at(self, place: int, size: int) -> bytes:
        """So many bytes at a place after the base; fewer where the file or the limit ends.

        Raises:
            OSError: the disk failed.
        """
        size = max(0, min(size, self._left[0]))
        try:
            self._file.seek(self.base + place)
            data = self._file.read(size)
        except (ValueError, OverflowError):
            return b""
        except OSError as error:
            if error.errno != errno.EINVAL:  # no such place; anything else is the disk's
                raise
            return b""
        self._left[0] -= len(data)
        return data

    def at(self, place: int) -> Reader:
        """The same file from another byte of it on, under the same limit."""
        other = Reader(self._file, self.base + place)
        other._left = self._left
        return other


def directories(reader: Reader) -> Iterator[Directory]:
    """Every directory from the TIFF header on, first things first; none where there is no header.

    [TIFF1992]; SubIFDs, EXIF and GPS directories are followed, a directory twice seen is not.
    """
    head = reader.bytes_at(0, 8)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or len(head) < 8:
        return
    if struct.unpack(order + "H", head[2:4])[0] not in MAGIC:
        return

    def at(place: int, kind: str) -> tuple[Directory, list[tuple[int, str]]]:
        directory, following = directory_at(reader, place, order, kind)
        further = []
        for tag, inner in ((EXIF_IFD, "exif"), (GPS_IFD, "gps"), (SUB_IFDS, "picture")):
            value = directory.tags.get(tag, ())
            if isinstance(value, tuple):
                further += [(int(v), inner) for v in value[:MAX_DIRECTORIES] if 0 < v < 1 << 32]
        if kind == "picture":
            further.append((following, "picture"))
        return directory, further

    yield from walk(struct.unpack(order + "I", head[4:])[0], at)


def walk(
    first: int, at: Callable[[int, str], tuple[Found, Sequence[tuple[int, str]]]]
) -> Iterator[Found]:
    """Every directory that can be reached from one: each once, `MAX_DIRECTORIES` at most.

    Args:
        first: place of the first; 0 is nowhere.
        at: reads the directory at a place, of a kind (see `Directory`); returns what it found, and
            place and kind of those to which it leads. Few of them: they are kept in memory.
    """
    pending = [(first, "picture")]
    seen: set[int] = set()
    while pending and len(seen) < MAX_DIRECTORIES:
        place, kind = pending.pop(0)
        if place == 0 or place in seen:
            continue
        seen.add(place)
        found, further = at(place, kind)
        yield found
        pending += further


def directory_at(reader: Reader, place: int, order: str, kind: str) -> tuple[Directory, int]:
    """One directory, and where the next of its chain is (0: nowhere).

    Args:
        reader: of the file.
        place: byte after the base.
        order: ``<`` or ``>``.
        kind: for the directory's name.
    """
    tags: dict[int, Value] = {}
    places: dict[int, int] = {}
    entries, following = entries_at(reader.bytes_at, place, order, MAX_ENTRIES)
    for entry in entries:
        if entry.size == 0 or entry.size > MAX_VALUE_BYTES:
            # Long tables (strip offsets) and unknown types hold nothing that is needed.
            continue
        where = entry.value_place(order)
        # Inline values are in the table that was read.
        in_place = entry.size <= 4
        data = entry.inline[: entry.size] if in_place else reader.bytes_at(where, entry.size)
        if len(data) == entry.size:
            tags[entry.tag] = _value(entry.type, entry.length, data, order)
            places[entry.tag] = reader.base + where
    return Directory(kind, tags, places), following or 0


def entries_at(
    take: Callable[[int, int], bytes], place: int, order: str, most: int
) -> tuple[list[Entry], int | None]:
    """A directory's entries, and where the next of its chain is (0: nowhere; None: it is cut).

    Args:
        take: gives so many bytes (second) from a place (first) on, fewer at the file's end.
        place: of the directory.
        order: ``<`` or ``>``.
        most: entries; a directory of more counts as cut, with none.
    """
    head = take(place, 2)
    count = struct.unpack(order + "H", head)[0] if len(head) == 2 else 0
    if len(head) < 2 or count > most:
        return [], None
    table = take(place + 2, 12 * count + 4)
    entries = []
    for index in range(min(count, len(table) // 12)):
        tag, type_, length, inline = struct.unpack_from(order + "HHI4s", table, 12 * index)
        entries.append(Entry(tag, type_, length, place + 10 + 12 * index, inline))
    rest = table[12 * count :]
    return entries, struct.unpack(order + "I", rest)[0] if len(rest) == 4 else None


def _value(type_: int, length: int, data: bytes, order: str) -> Value:
    if type_ in _PAIRS:
        parts = struct.unpack(f"{order}{2 * length}{_PAIRS[type_]}", data)
        pairs = zip(parts[::2], parts[1::2], strict=True)
        return tuple(a / b if b else float("nan") for a, b in pairs)
    letter = _LETTERS[type_]
    if letter == "s":
        return data
    return tuple(struct.unpack(f"{order}{length}{letter}", data))
