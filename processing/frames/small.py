"""Small pictures of photographs: means over squares and over larger cells, from half floats."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence

import cv2
import numpy as np
from numba import njit

from lightstage.formats.half import as_float

BRIGHT_PX = 2_000_000
"""What was lit is searched for in about this many pixels, and in means of squares where there are
more."""


def bright_side(shape: tuple[int, int]) -> int:
    """Pixels a side of the squares of a picture of (rows, columns)."""
    return max(1, round(float(np.sqrt(shape[0] * shape[1] / BRIGHT_PX))))


def cell_side(shape: tuple[int, int], wanted_px: float) -> int:
    """Pixels a side of a picture's cells: whole squares, about `wanted_px`."""
    side = bright_side(shape)
    return max(1, round(wanted_px / side)) * side


@dataclasses.dataclass(frozen=True)
class SmallPictures:
    """Small pictures that grow while photographs are written; rows of several may come at once.

    Attributes:
        shape: rows and columns of the photographs.
        side: pixels of a square, and
        cell: of a cell, a whole number of squares.
        small: pattern to (rows // cell, columns // cell, 3) float32, means over cells.
        bright: (rows // side, columns // side) float32, the largest over patterns and colours of
            means over squares, not below 0.
    """

    shape: tuple[int, int]
    side: int
    cell: int
    small: dict[str, np.ndarray]
    bright: np.ndarray
    _lock: threading.Lock = dataclasses.field(default_factory=threading.Lock, repr=False)

    @classmethod
    def empty(cls, shape: tuple[int, int], patterns: Sequence[str], cell: int) -> SmallPictures:
        """Of photographs that are still to come."""
        side, size = bright_side(shape), (shape[0] // cell, shape[1] // cell, 3)
        if cell % side:
            raise ValueError(f"cells of {cell} pixels, squares of {side}")
        small = {name: np.zeros(size, np.float32) for name in patterns}
        bright = np.zeros((shape[0] // side, shape[1] // side), np.float32)
        return cls(shape, side, cell, small, bright)

    def add(self, pattern: str, top: int, rows: np.ndarray) -> None:
        """Add rows of a photograph, each once.

        Args:
            pattern: whose they are.
            top: of the first, a multiple of `cell`.
            rows: (n, columns, 3) float16, n a multiple of `cell` or up to the picture's end.
        """
        if top % self.cell:
            raise ValueError(f"row {top} begins no cell of {self.cell}")
        bits = np.ascontiguousarray(rows).view(np.uint16).reshape(len(rows), -1)
        squares = np.zeros((len(rows) // self.side, self.bright.shape[1]), np.float32)
        cells = self.small[pattern][top // self.cell :]
        _shrink(bits, self.side, self.cell // self.side, squares, cells)
        first = top // self.side
        with self._lock:
            here = self.bright[first : first + len(squares)]
            np.maximum(here, squares, out=here)


def small_pictures(half: np.ndarray, patterns: Sequence[str], cell: int) -> SmallPictures:
    """Small pictures of (P, h, w, 3) float16 photographs that are there."""
    out = SmallPictures.empty((half.shape[1], half.shape[2]), patterns, cell)
    for name, picture in zip(patterns, half, strict=True):
        out.add(name, 0, picture)
    return out


def cell_means(picture: np.ndarray, cell: int) -> np.ndarray:
    """(h // cell, w // cell, 3) float32 means over cells of (h, w, 3) float16."""
    rows, columns = picture.shape[0] // cell, picture.shape[1] // cell
    out, squares = np.zeros((rows, columns, 3), np.float32), np.zeros((rows, columns), np.float32)
    bits = np.ascontiguousarray(picture).view(np.uint16).reshape(len(picture), -1)
    _shrink(bits, cell, 1, squares, out)
    return out


@njit(cache=True, nogil=True)
def _shrink(
    bits: np.ndarray, side: int, times: int, squares: np.ndarray, cells: np.ndarray
) -> None:
    """Rows of halves (n, 3 w) to squares' largest mean colour, and to cells of times squares."""
    share = np.float32(1 / (side * side))
    part = np.float32(1 / (times * times))
    line = np.empty(3 * side * squares.shape[1], np.float32)
    for y in range(len(squares)):
        line[:] = 0
        for row in range(y * side, y * side + side):
            source = bits[row]
            for i in range(len(line)):
                line[i] += as_float(source[i])
        down = y // times
        for x in range(squares.shape[1]):
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for i in range(3 * side * x, 3 * side * (x + 1), 3):
                red += line[i]
                green += line[i + 1]
                blue += line[i + 2]
            red, green, blue = red * share, green * share, blue * share
            squares[y, x] = max(red, max(green, blue))
            across = x // times
            if down < len(cells) and across < cells.shape[1]:
                cells[down, across, 0] += red * part
                cells[down, across, 1] += green * part
                cells[down, across, 2] += blue * part


def shrunk(picture: np.ndarray, cell: int) -> np.ndarray:
    """Means over square cells; a cell with a value that is not finite becomes 0.

    Args:
        picture: (h, w, 3), halves or other floats.
        cell: pixels a side; rows and columns that fill no cell are dropped.

    Returns:
        (h // cell, w // cell, 3) float32, finite.
    """
    height, width = picture.shape[0] // cell, picture.shape[1] // cell
    part = picture[: height * cell, : width * cell]
    if part.dtype == np.float16:
        small = cell_means(part, cell)
    else:
        small = np.asarray(part, np.float32)
        if cell > 1:
            small = cv2.resize(small, (width, height), interpolation=cv2.INTER_AREA)
    return np.nan_to_num(small, nan=0.0, posinf=0.0, neginf=0.0)


def free_cells(usable: np.ndarray, cell: int) -> np.ndarray:
    """(h // cell, w // cell) bool: cells all of whose pixels are usable.

    Args:
        usable: (h, w) bool.
        cell: pixels a side.
    """
    height, width = usable.shape[0] // cell, usable.shape[1] // cell
    out = np.ones((height, width), bool)
    rows, columns = np.divmod(np.flatnonzero(~usable), usable.shape[1])
    rows, columns = rows // cell, columns // cell
    inside = (rows < height) & (columns < width)
    out[rows[inside], columns[inside]] = False
    return out
