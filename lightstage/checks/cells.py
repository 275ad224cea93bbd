"""Light, clipping and fine detail of a mosaic in square cells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FAR = 3
"""Step of the longer second difference, in quads; the shorter one's is a quad."""
REACH = 2 * FAR
SMALL_PX = 10_000
"""A mosaic of fewer pixels is summed sooner than the compiled loop is loaded."""


class Cells(NamedTuple):
    """A mosaic in cells of `quads` x `quads` quads of 2 x 2 pixels.

    Attributes:
        light: (rows, columns, 3) mean above black of each colour.
        detail: (rows, columns, 3) variance of a green pixel from the difference of a quad's two
            greens; mean squared second difference of greens (a quad's mean) at steps of one quad
            and of `FAR` quads, along rows and columns.
        clipped: (rows, columns, 3) int64 clipped pixels of each colour.
        extremes: (4,) least and greatest count, how many pixels have the greatest, how many are
            not finite.
    """

    light: np.ndarray
    detail: np.ndarray
    clipped: np.ndarray
    extremes: np.ndarray


def sum_cells(
    counts: np.ndarray,
    colours: np.ndarray,
    black: np.ndarray | float,
    white: float,
    quads: int,
) -> Cells:
    """Sum a mosaic.

    Args:
        counts: (h, w) of any real type; what is not finite counts as black and is counted.
        colours: (2, 2) colour 0, 1 or 2 of each place in a quad.
        black: counts without light, one number or (2, 2), by place.
        white: counts from which a pixel is clipped.
        quads: side of a cell.
    """
    colours = np.ascontiguousarray(colours, np.int64)
    dark = np.full((2, 2), black, float)
    if counts.size < SMALL_PX:
        return plain_cells(counts, colours, dark, white, quads)
    from lightstage.checks.kernels import cells_kernel

    rows, columns = counts.shape[0] // 2 // quads, counts.shape[1] // 2 // quads
    light, detail = np.empty((rows, columns, 3)), np.empty((rows, columns, 3))
    cells = Cells(light, detail, np.empty((rows, columns, 3), np.int64), np.empty(4))
    cells_kernel(counts, colours, dark, white, quads, *cells)
    return cells


def plain_cells(
    counts: np.ndarray, colours: np.ndarray, black: np.ndarray, white: float, quads: int
) -> Cells:
    """The same in plain float64 numpy; black is (2, 2)."""
    wide = counts.astype(float)
    high, long = wide.shape[0] // 2, wide.shape[1] // 2
    rows, columns = high // quads, long // quads
    light = np.zeros((rows, columns, 3))
    clipped = np.zeros((rows, columns, 3), np.int64)
    number = np.zeros(3)
    planes: list[np.ndarray] = []
    for y in range(2):
        for x in range(2):
            plane = wide[y : 2 * high : 2, x : 2 * long : 2]
            above = np.where(np.isfinite(plane), plane - black[y, x], 0.0)
            full = np.where(np.isfinite(plane), plane, black[y, x]) >= white
            colour = colours[y, x]
            light[..., colour] += _pooled(above, quads).sum(axis=(1, 3))
            clipped[..., colour] += _pooled(full, quads).sum(axis=(1, 3))
            number[colour] += quads**2
            if colour == 1:
                planes.append(above)
    light /= np.maximum(number, 1)
    green = np.mean(planes, axis=0) if planes else np.zeros((high, long))
    detail = np.zeros((rows, columns, 3))
    if len(planes) == 2:
        detail[..., 0] = _pooled(0.5 * (planes[1] - planes[0]) ** 2, quads).mean(axis=(1, 3))
    for index, lag in ((1, 1), (2, FAR)):
        energy = np.zeros_like(green)
        inner = slice(0, max(high - REACH, 0)), slice(0, max(long - REACH, 0))
        here = green[inner]
        tall, broad = here.shape
        across = (
            here - 2 * green[:tall, lag : lag + broad] + green[:tall, 2 * lag : 2 * lag + broad]
        )
        down = here - 2 * green[lag : lag + tall, :broad] + green[2 * lag : 2 * lag + tall, :broad]
        energy[inner] = 0.5 * (across**2 + down**2)
        detail[..., index] = _pooled(energy, quads).mean(axis=(1, 3))
    whole = wide[: 2 * rows * quads, : 2 * columns * quads]
    finite = np.isfinite(whole)
    values = np.where(finite, whole, np.tile(black, (rows * quads, columns * quads)))
    greatest = values.max()
    pile, wild = np.count_nonzero(values == greatest), np.count_nonzero(~finite)
    return Cells(light, detail, clipped, np.array([values.min(), greatest, pile, wild], float))


def _pooled(plane: np.ndarray, quads: int) -> np.ndarray:
    """(rows, quads, columns, quads) of the whole cells."""
    rows, columns = plane.shape[0] // quads, plane.shape[1] // quads
    return plane[: rows * quads, : columns * quads].reshape(rows, quads, columns, quads)
