"""What kind of file a photograph is, from its bytes, and whether it is whole."""

from __future__ import annotations

import dataclasses
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

from lightstage.containers import JPEG_HEAD, MOST_PARTS
from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.tiff import MAX_DIRECTORIES, SUB_IFDS, Entry, entries_at, walk

_EXR = b"\x76\x2f\x31\x01"
_DNG_VERSION, _MAKE = 50706, 271
_REDUCED, _PHOTOMETRIC = 254, 262
_DEVELOPED = {2, 5, 6, 8}
"""PhotometricInterpretation of RGB, CMYK, YCbCr and L*a*b* [TIFF1992]: no sensor's counts."""
_CFA = 32803
_PLACES = {273: 279, 324: 325}
"""Tags of strip and tile offsets, and those of their byte counts."""
_MAKERS = {b"NIKON": ".nef", b"Canon": ".cr2", b"SONY": ".arw", b"PENTAX": ".pef"}
_MAKERS |= {b"EASTMAN KODAK": ".kdc", b"Eastman Kodak": ".kdc", b"Kodak": ".kdc", b"KODAK": ".kdc"}
_MAKERS |= {b"Hasselblad": ".3fr", b"Phase One": ".iiq", b"Leaf": ".mos", b"Mamiya": ".mef"}
_MAKERS |= {b"SAMSUNG": ".srw", b"SEIKO EPSON": ".erf", b"RICOH": ".pef"}
_HEADS = {
    (0, b"IIRO"): ".orf",
    (0, b"IIRS"): ".orf",
    (0, b"MMOR"): ".orf",
    (0, b"IIU\0"): ".rw2",
    (0, b"\0MRM"): ".mrw",
    (0, b"FOVb"): ".x3f",
    (6, b"HEAPCCDR"): ".crw",
}
"""Containers that LibRaw reads beside TIFF, CR3 and RAF: by their first bytes."""
_RAF_PARTS = (84, 92, 100)
"""Where a RAF's header has offset and length of its preview, its header and its counts."""
_MOST_ENTRIES = (1 << 16) - 1
_READ = (_DNG_VERSION, _MAKE, SUB_IFDS, _REDUCED, _PHOTOMETRIC)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A photograph's file type: suffix with a dot, and the session's `encoding`."""

    suffix: str
    encoding: Literal["raw", "linear"]


@dataclasses.dataclass(frozen=True)
class _Source:
    """A file's bytes, taken in parts.

    Attributes:
        size: bytes in all.
        take: gives so many bytes from an offset on, fewer at the end.
    """

    size: int
    take: Callable[[int, int], bytes]

    def unpack(self, form: str, offset: int) -> tuple[Any, ...]:
        """struct.unpack at an offset; struct.error beyond the end."""
        length = struct.calcsize(form)
        if not 0 <= offset <= self.size - length:
            raise struct.error("beyond the end")
        return struct.unpack(form, self.take(offset, length))


def identify(data: bytes, where: str | Path) -> Kind:
    """Recognise a RAW, DNG or OpenEXR photograph by its bytes; the name counts for nothing.

    The header must parse, and a file must be as long as its directories, boxes or header require.

    Args:
        data: the whole file.
        where: what to name in an error.

    Raises:
        FormatError: another kind of file (a JPEG holds no linear light), or a truncated one.
    """
    return _identify(_Source(len(data), lambda at, size: data[at : at + size]), where)


def identify_file(path: Path, where: str | Path | None = None) -> Kind:
    """The same for a file on the disk; only its header is read.

    Args:
        path: the file.
        where: what to name in an error; the path where None.

    Raises:
        FormatError: as `identify`.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        handle = file.fileno()
        source = _Source(os.fstat(handle).st_size, lambda at, size: os.pread(handle, size, at))
        return _identify(source, path if where is None else where)


def _identify(source: _Source, where: str | Path) -> Kind:
    head = source.take(0, 16)
    if head[:4] == _EXR:
        return Kind(".exr", "linear")
    if head[:4] in (b"II*\0", b"MM\0*"):
        return Kind(_tiff_suffix(source, "<" if head[:2] == b"II" else ">", where), "raw")
    if head[4:11] == b"ftypcrx":
        _require_length(source, where, _cr3_length)
        return Kind(".cr3", "raw")
    if head[:15] == b"FUJIFILMCCD-RAW":
        _require_length(source, where, _raf_length)
        return Kind(".raf", "raw")
    for (at, begins), suffix in _HEADS.items():
        if head[at:].startswith(begins):
            return Kind(suffix, "raw")
    jpeg = head.startswith(JPEG_HEAD)
    begun = f"{counted(source.size, 'byte')}, beginning with {head[:8].hex() or 'none'}"
    raise FormatError(
        where,
        found="a JPEG" if jpeg else begun,
        expected="a camera RAW, a DNG or an OpenEXR picture",
        hint="Set the camera's picture format to RAW."
        if jpeg
        else "This is no photograph, or the file's beginning is damaged.",
    )


def _require_length(
    source: _Source, where: str | Path, wanted: Callable[[_Source], int | None]
) -> None:
    """Refuse a file that is shorter than by its own header, or whose header is cut."""
    try:
        length = wanted(source)
    except struct.error:
        raise _truncated(where, source.size, "a whole header") from None
    if length is not None and length > source.size:
        raise _truncated(where, source.size, f"picture data up to byte {length}")


def _cr3_length(source: _Source) -> int | None:
    """Where the last box of a CR3 ends; struct.error where a box's head is cut."""
    place, kinds = 0, []
    for _ in range(MOST_PARTS):
        if place >= source.size:
            break
        size, kind = source.unpack(">I4s", place)
        kinds.append(kind)
        if size == 1:
            (size,) = source.unpack(">Q", place + 8)
        if size == 0:  # to the file's end
            return None
        if size < 8:
            raise struct.error("a box without content")
        place += size
    if place <= source.size and b"mdat" not in kinds:
        raise struct.error("no picture data")
    return place


def _raf_length(source: _Source) -> int:
    """Where the last part of a RAF ends; struct.error where the header is cut."""
    ends = [sum(source.unpack(">II", place)) for place in _RAF_PARTS]
    return max(ends)


def _tiff_suffix(source: _Source, order: str, where: str | Path) -> str:
    suffix = ""
    photometric: set[int] = set()
    try:
        for tags in _directories(source, order):
            if not tags.get(_REDUCED, [0])[0] & 1:
                values = tags.get(_PHOTOMETRIC, [])
                photometric |= set(values or ([-1] if _PLACES.keys() & tags.keys() else []))
            if _DNG_VERSION in tags:
                suffix = ".dng"
            elif _MAKE in tags and not suffix:
                make = bytes(tags[_MAKE])
                suffix = next((s for name, s in _MAKERS.items() if make.startswith(name)), "")
            _require_whole(tags, source.size, where)
    except struct.error:
        raise _truncated(where, source.size, "a directory beyond the end") from None
    # A camera's RAW has a small developed preview; a developed picture is that alone.
    canon = source.take(8, 2) == b"CR"
    if suffix != ".dng" and not canon and photometric and photometric <= _DEVELOPED:
        raise FormatError(
            where,
            found="a TIFF of developed colours",
            expected="a camera RAW, a DNG or an OpenEXR picture",
            hint="`lightstage import` takes it; a capture needs the camera's RAW.",
        )
    if not suffix and _CFA in photometric:
        return ".tif"
    if not suffix:
        raise FormatError(
            where,
            found="a TIFF without DNGVersion, of no known maker",
            expected="a camera RAW, a DNG or an OpenEXR picture",
        )
    return suffix


def _directories(source: _Source, order: str) -> Iterator[dict[int, list[int]]]:
    """The TIFF's directories, SubIFDs too: tag to its values; struct.error where one is cut."""

    def at(place: int, kind: str) -> tuple[dict[int, list[int]], list[tuple[int, str]]]:
        entries, following = entries_at(source.take, place, order, _MOST_ENTRIES)
        if following is None:
            raise struct.error("a directory that is cut")
        tags = {
            entry.tag: _values(source, order, entry)
            for entry in entries
            if entry.tag in (*_READ, *_PLACES, *_PLACES.values())
        }
        inner = tags.get(SUB_IFDS, [])[:MAX_DIRECTORIES]
        return tags, [(each, kind) for each in (*inner, following)]

    yield from walk(source.unpack(order + "I", 4)[0], at)


def _values(source: _Source, order: str, entry: Entry) -> list[int]:
    """Whole numbers without a sign; struct.error of other types and beyond the end."""
    letter = {1: "B", 2: "H", 4: "I"}.get(entry.each, "")
    if not letter or entry.length > source.size:
        raise struct.error("a tag of no such type")
    return list(source.unpack(f"{order}{entry.length}{letter}", entry.value_place(order)))


def _require_whole(tags: dict[int, list[int]], size: int, where: str | Path) -> None:
    for offsets, counts in _PLACES.items():
        ends = [o + c for o, c in zip(tags.get(offsets, []), tags.get(counts, []), strict=False)]
        if ends and max(ends) > size:
            raise _truncated(where, size, f"picture data up to byte {max(ends)}")


def _truncated(where: str | Path, size: int, expected: str) -> FormatError:
    return FormatError(
        where,
        found=counted(size, "byte"),
        expected=expected,
        hint="The file is truncated; download or copy it again.",
    )
