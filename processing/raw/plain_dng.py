"""DNG files that hold their counts as they are: mapped from the disk instead of unpacked.

Only the pages of the rows that are developed are read. Other tags that a file may have are listed
here; a file that has anything else of its counts (compression, a curve, corrections) is LibRaw's.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lightstage.formats.orientation import OF_TIFF, Orientation
from lightstage.tiff import Directory, Reader, directories

CFA = 32803
WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, ORIENTATION = 256, 257, 258, 259, 262, 274
STRIPS, SAMPLES, STRIP_BYTES = 273, 277, 279
PATTERN_SIZE, PATTERN, PLANES, LAYOUT = 33421, 33422, 50710, 50711
BLACK_REPEATS, BLACK, WHITE, NEUTRAL = 50713, 50714, 50717, 50728
_PLAIN: dict[int, tuple[int, ...]] = {
    254: (0,),
    BITS: (16,),
    COMPRESSION: (1,),
    PHOTOMETRIC: (CFA,),
    SAMPLES: (1,),
}
_PLAIN |= {PATTERN_SIZE: (2, 2)}
"""Tags and the one value that each must have."""
_IF_PRESENT: dict[int, tuple[int, ...]] = {284: (1,), 339: (1,), PLANES: (0, 1, 2), LAYOUT: (1,)}
_DNG = {50706, 50707, 50708, PLANES, LAYOUT, BLACK_REPEATS, BLACK, WHITE, NEUTRAL}
_DNG |= {50721, 50722, 50723, 50724, 50727, 50730, 50731, 50732, 50734, 50735, 50778, 50779}
_DNG |= {50781, 50931, 50932, 50933, 50936, 50964, 50965}
"""Tags of DNG [DNG14] that do not change what a count means, and those that are read here."""


@dataclasses.dataclass(frozen=True)
class PlainDng:
    """Counts and what they mean, as `raw.file.RawFile` names it."""

    counts: np.ndarray
    colours: np.ndarray
    black: np.ndarray
    white: float
    neutral: np.ndarray
    orientation: Orientation


def map_plain_dng(path: Path) -> PlainDng | None:
    """Map a file's counts, changes to which stay in memory; None where LibRaw must read it.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb", buffering=1 << 14) as file:
        reader = Reader(file)
        little = reader.bytes_at(0, 4) == b"II*\0"
        found = list(directories(reader)) if little else []
        pictures = [one for one in found if one.kind == "picture" and one.tags]
        file.seek(0, 2)
        length = file.tell()
    if len(pictures) != 1 or not _plain(pictures[0]):
        return None
    tags = pictures[0]
    size = _number(tags, HEIGHT), _number(tags, WIDTH)
    first = _strips(tags, 2 * size[0] * size[1])
    if min(size) < 2 or first is None or first % 2 or first + 2 * size[0] * size[1] > length:
        return None
    colours = np.frombuffer(bytes(_bytes(tags, PATTERN)), np.uint8).astype(np.int64)
    if sorted(colours.tolist()) != [0, 1, 1, 2] or colours[0] == colours[2]:
        return None
    black, white = _levels(tags)
    gains = _gains(tags)
    if black is None or gains is None or not white > black.max():
        return None
    counts = np.memmap(path, "<u2", "c", first, size)
    orientation = OF_TIFF[_number(tags, ORIENTATION, 1)]
    return PlainDng(counts, colours.reshape(2, 2), black, white, gains, orientation)


def _plain(directory: Directory) -> bool:
    """Whether a picture holds plain counts, and has no unknown tag about them."""
    tags = directory.tags
    usual = all(tags.get(tag) == value for tag, value in _PLAIN.items())
    usual &= all(tags.get(tag, value) == value for tag, value in _IF_PRESENT.items())
    known = all(tag in _DNG for tag in tags if tag >= 50706)
    return usual and known and 50706 in tags and _number(directory, ORIENTATION, 1) in OF_TIFF


def _number(directory: Directory, tag: int, usual: int = 0) -> int:
    value = directory.number(tag)
    return usual if value is None else int(value)


def _bytes(directory: Directory, tag: int) -> list[int]:
    """Small whole numbers, however they are stored."""
    value = directory.tags.get(tag, ())
    return [int(v) for v in value]


def _strips(directory: Directory, length: int) -> int | None:
    """Where the counts begin; None where they are not `length` bytes in one piece."""
    begins, lengths = (directory.tags.get(tag, ()) for tag in (STRIPS, STRIP_BYTES))
    if isinstance(begins, bytes) or isinstance(lengths, bytes) or not begins:
        return None
    if len(begins) != len(lengths) or sum(lengths) != length:
        return None
    ends = [a + b for a, b in zip(begins, lengths, strict=True)]
    return int(begins[0]) if ends[:-1] == list(begins[1:]) else None


def _levels(directory: Directory) -> tuple[np.ndarray | None, float]:
    """(2, 2) black counts of the mosaic's places, and the white one."""
    white = directory.number(WHITE)
    value = directory.tags.get(BLACK, (0.0,))
    repeats = tuple(_bytes(directory, BLACK_REPEATS)) or (1, 1)
    if white is None or isinstance(value, bytes) or repeats not in ((1, 1), (2, 2)):
        return None, 0.0
    # LibRaw reckons with whole counts.
    if len(value) != repeats[0] * repeats[1] or any(v != int(v) for v in value):
        return None, 0.0
    black = np.array(value, float).reshape(repeats)
    return np.broadcast_to(black, (2, 2)).copy(), float(white)


def _gains(directory: Directory) -> np.ndarray | None:
    """(3,) that turn the camera's own white grey; None where the file does not have it so."""
    value = directory.tags.get(NEUTRAL)
    if value is None or isinstance(value, bytes) or len(value) != 3 or min(value) <= 0:
        return None
    gains = 1 / np.array(value, float)
    return gains if np.isfinite(gains).all() else None
