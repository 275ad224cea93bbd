"""A rectangle of a picture: the part of a photograph that holds the face."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Window:
    """Rows and columns of a picture that are kept.

    Attributes:
        top: first row.
        left: first column.
        height: rows.
        width: columns.
    """

    top: int
    left: int
    height: int
    width: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """To cut the window out of a whole picture: ``picture[window.slices]``."""
        return (
            slice(self.top, self.top + self.height),
            slice(self.left, self.left + self.width),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.height, self.width

    @property
    def empty(self) -> bool:
        """Whether no pixel is inside."""
        return self.height <= 0 or self.width <= 0

    def inside(self, shape: tuple[int, int]) -> bool:
        """Whether it is wholly in a picture of (rows, columns)."""
        return (
            self.top >= 0
            and self.left >= 0
            and self.top + self.height <= shape[0]
            and self.left + self.width <= shape[1]
        )

    def grown(self, pixels: int, shape: tuple[int, int]) -> Window:
        """The window with `pixels` more on each side, as far as a picture of `shape` goes."""
        top, left = max(self.top - pixels, 0), max(self.left - pixels, 0)
        bottom = min(self.top + self.height + pixels, shape[0])
        right = min(self.left + self.width + pixels, shape[1])
        return Window(top, left, max(bottom - top, 0), max(right - left, 0))

    def and_also(self, other: Window) -> Window:
        """What both hold."""
        top, left = max(self.top, other.top), max(self.left, other.left)
        bottom = min(self.top + self.height, other.top + other.height)
        right = min(self.left + self.width, other.left + other.width)
        return Window(top, left, max(bottom - top, 0), max(right - left, 0))

    def placed(self, inner: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """A whole picture (H, W, ...) with `inner` (height, width, ...) in it and zeros around."""
        out = np.zeros((*shape, *inner.shape[2:]), inner.dtype)
        out[self.slices] = inner
        return out


def whole(shape: tuple[int, int]) -> Window:
    """The window that is all of a picture of (rows, columns)."""
    return Window(0, 0, shape[0], shape[1])


def box_of(mask: np.ndarray) -> Window:
    """The smallest window with all true pixels of a (h, w) mask; empty where there are none."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return Window(0, 0, 0, 0)
    top, left = int(rows[0]), int(columns[0])
    return Window(top, left, int(rows[-1]) + 1 - top, int(columns[-1]) + 1 - left)
