"""Closed rings of places on the vertex grid, around an eye and around the mouth.

A place is a row and a column of the grid, as floats. All rings of one opening have as many points
as the border of the rectangle of grid points that they replace, and begin at the middle of its left
side; from there they run over the upper side to the right and back over the lower one. Points of
one number are beside each other on all rings.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from sim.head.layout import layout

Positions = Callable[[np.ndarray], np.ndarray]
"""From (k, 2) places to (k, 3) mm."""

FINE = 64
"""Points of a curve for each grid column, between which its length is measured."""
TILE = np.array([2.0, 3.0])
"""Of the UV tile, in which its lengths are even."""
STEP = 0.5
"""How much of the way to its harmonic place a point goes in a round."""
FINER = 3
"""Times as many rings as are returned are spread."""
NEWTON_ROUNDS = 40
EPSILON = 1e-5
"""Of a row or column."""


@dataclasses.dataclass(frozen=True)
class Block:
    """A rectangle of grid points, all inclusive; its rows are as many above its middle as below."""

    top: int
    bottom: int
    left: int
    right: int

    def border(self) -> np.ndarray:
        """(n, 2) int row and column of its border's points, as a ring."""
        middle = (self.top + self.bottom) // 2
        rows, columns = np.arange(self.top, self.bottom + 1), np.arange(self.left, self.right + 1)
        sides = (
            [(row, self.left) for row in range(middle, self.top, -1)],
            [(self.top, column) for column in columns[:-1]],
            [(row, self.right) for row in rows[:-1]],
            [(self.bottom, column) for column in columns[:0:-1]],
            [(row, self.left) for row in range(self.bottom, middle, -1)],
        )
        return np.array([place for side in sides for place in side])


@dataclasses.dataclass(frozen=True)
class Opening:
    """An opening's closed curve: two rows, joined by half an ellipse at either end.

    Attributes:
        upper: its row above.
        lower: its row below.
        left: the column of its left end.
        right: the column of its right end.
        end: columns of each ellipse's half axis.
    """

    upper: float
    lower: float
    left: float
    right: float
    end: float

    def ring(self, shares: np.ndarray, positions: Positions) -> np.ndarray:
        """(n, 2) places on the curve.

        Args:
            shares: (n / 2 + 1,) 0..1 of the length of either half where its points are.
            positions: of places.
        """
        over = self._spread(self.upper, shares, positions)
        under = self._spread(self.lower, shares, positions)
        return np.concatenate([over[:-1], under[:0:-1]])

    def _spread(self, row: float, shares: np.ndarray, positions: Positions) -> np.ndarray:
        """(len(shares), 2) places from the left end to the right one, along one row."""
        middle = (self.upper + self.lower) / 2
        straight = self.right - self.left - 2 * self.end
        angle = np.linspace(0, np.pi / 2, int(FINE * self.end) + 2)
        across = self.end * (1 - np.cos(angle))
        height = middle + (row - middle) * np.sin(angle)
        between = np.linspace(0, straight, int(FINE * straight) + 2)[1:-1]
        column = np.concatenate(
            [self.left + across, self.left + self.end + between, self.right - across[::-1]]
        )
        rows = np.concatenate([height, np.full(len(between), row), height[::-1]])
        curve = np.stack([rows, column], axis=1)
        length = np.linalg.norm(np.diff(positions(curve), axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(length)])
        wanted = shares * along[-1]
        return np.stack([np.interp(wanted, along, each) for each in curve.T], axis=1)


def shares_of(border: np.ndarray, follow: float, positions: Positions) -> np.ndarray:
    """(n / 2 + 1,) 0..1 of a ring's halves, between even steps and those of the border's sides.

    Args:
        border: (n, 2) places.
        follow: how much of a step is the border's, 0..1; the rest is even.
        positions: of places.
    """
    half = len(border) // 2
    step = np.linalg.norm(np.diff(positions(border[[*range(len(border)), 0]]), axis=0), axis=1)
    # Both halves have the same shares, so that their points are above each other.
    step = step[:half] + step[: half - 1 : -1]
    along = np.concatenate([[0.0], np.cumsum(step)]) / step.sum()
    return follow * along + (1 - follow) * np.linspace(0, 1, half + 1)


def between(
    outer: np.ndarray, inner: np.ndarray, steps: int, rounds: int, even: float
) -> np.ndarray:
    """(steps - 1, n, 2) rings that lead from one ring (n, 2) to another, both left out.

    They begin as straight lines from point to point. Each round goes nearer to the rings whose
    number and whose points' number are harmonic on the plane: such rings keep apart where a border
    juts out, and no quad is turned over [Thompson1974].
    """
    fine = steps * FINER
    part = (np.arange(fine + 1) / fine)[:, None, None]
    rings = outer + (inner - outer) * part
    for _ in range(rounds):
        before, after = np.roll(rings, 1, axis=1), np.roll(rings, -1, axis=1)
        along = 0.5 * (after - before)[1:-1]
        across = 0.5 * (rings[2:] - rings[:-2])
        twist = 0.25 * (after[2:] - after[:-2] - before[2:] + before[:-2])
        a = (across**2).sum(axis=2, keepdims=True)
        b = (along * across).sum(axis=2, keepdims=True)
        c = (along**2).sum(axis=2, keepdims=True)
        pull = a * (after + before)[1:-1] + c * (rings[2:] + rings[:-2]) - 2 * b * twist
        rings[1:-1] += STEP * (pull / (2 * (a + c)) - rings[1:-1])
    return _even_across(rings, steps, even)


def _even_across(rings: np.ndarray, steps: int, even: float) -> np.ndarray:
    """(steps - 1, n, 2) rings at more even steps along the lines between points of one number.

    Harmonic rings crowd around the inner one.
    """
    length = np.linalg.norm(np.diff(rings, axis=0), axis=2)
    along = np.concatenate([np.zeros((1, rings.shape[1])), np.cumsum(length, axis=0)])
    out = np.empty((steps - 1, *rings.shape[1:]))
    for point, reached in enumerate(along.T):
        equal = reached[-1] * np.arange(1, steps) / steps
        wanted = even * equal + (1 - even) * reached[FINER:-1:FINER]
        for axis in range(2):
            out[:, point, axis] = np.interp(wanted, reached, rings[:, point, axis])
    return out


class Chart:
    """The UV layout over a block of the grid: a plane in which the skin is hardly stretched."""

    def __init__(self, block: Block) -> None:
        """Its triangles are those of the block's quads, cut as those of the head's mesh."""
        rows, columns = slice(block.top, block.bottom + 1), slice(block.left, block.right + 1)
        places = np.stack(np.meshgrid(
            np.arange(block.top, block.bottom + 1.0), np.arange(block.left, block.right + 1.0),
            indexing="ij",
        ), axis=-1)  # fmt: skip
        self._uv = layout()[rows, columns] * TILE
        self._block, self._places = block, places

    def of(self, places: np.ndarray) -> np.ndarray:
        """(..., 2) of places (..., 2) of the block, bilinear in each cell."""
        at = places - (self._block.top, self._block.left)
        low = np.clip(np.floor(at).astype(int), 0, np.array(self._uv.shape[:2]) - 2)
        r, c = np.moveaxis((at - low)[..., None, :], -1, 0)
        i, j = np.moveaxis(low, -1, 0)
        uv = self._uv
        above = (1 - c) * uv[i, j] + c * uv[i, j + 1]
        below = (1 - c) * uv[i + 1, j] + c * uv[i + 1, j + 1]
        return np.asarray((1 - r) * above + r * below)

    def places(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) places of (n, 2) points of the chart; the nearest cell's of those beyond it."""
        i, j = np.divmod(np.arange((self._uv[:-1, :-1, 0]).size), self._uv.shape[1] - 1)
        middle = self._uv[i, j] + self._uv[i + 1, j] + self._uv[i + 1, j + 1] + self._uv[i, j + 1]
        cell = cKDTree(middle / 4).query(points)[1]
        at = np.stack([i[cell], j[cell]], axis=1) + 0.5
        low, high = (0, 0), np.array(self._uv.shape[:2]) - 1 - 1e-9
        start = (self._block.top, self._block.left)
        for _ in range(NEWTON_ROUNDS):
            here = self.of(at + start)
            # Backward differences would leave the block at its border.
            ahead = np.where(at < high - EPSILON, EPSILON, -EPSILON)
            by_row = (self.of(at + start + ahead * (1, 0)) - here) / ahead[:, :1]
            by_column = (self.of(at + start + ahead * (0, 1)) - here) / ahead[:, 1:]
            slopes = np.stack([by_row, by_column], axis=2)
            step = np.linalg.solve(slopes, (points - here)[..., None])[..., 0]
            at = np.clip(at + np.clip(step, -1, 1), low, high)
        return at + start
