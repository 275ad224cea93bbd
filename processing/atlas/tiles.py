"""The atlas in square tiles: texels in an order that caches like."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

TILE_PX = 64
"""Side of a tile: its texels are within a few hundred pixels of a picture, which caches hold."""


@dataclasses.dataclass(frozen=True)
class Tiles:
    """Covered texels, tile after tile; tiles without any are left out.

    Attributes:
        flat: (k,) int32 index of each texel in the atlas.
        start: (t + 1,) int64, tile i holds texels start[i] to start[i + 1].
    """

    flat: np.ndarray
    start: np.ndarray


def tiled(face: np.ndarray, side_px: int = TILE_PX) -> Tiles:
    """Order the covered texels of a raster.

    Args:
        face: (rows, columns) int32, -1 where nothing is.
        side_px: of a tile.
    """
    counts = np.zeros((-(-face.shape[0] // side_px), -(-face.shape[1] // side_px)), np.int64)
    _count(face, side_px, counts)
    ends = np.cumsum(counts.ravel())
    flat = np.empty(int(ends[-1]) if ends.size else 0, np.int32)
    _place(face, side_px, (ends - counts.ravel()).reshape(counts.shape), flat)
    kept = np.flatnonzero(counts.ravel())
    start = np.concatenate([ends[kept] - counts.ravel()[kept], ends[-1:]])
    return Tiles(flat, start.astype(np.int64))


@numba.njit(cache=True, parallel=True)
def _count(face: np.ndarray, side: int, counts: np.ndarray) -> None:
    rows, columns = face.shape
    for tile_row in numba.prange(counts.shape[0]):
        for row in range(tile_row * side, min((tile_row + 1) * side, rows)):
            for column in range(columns):
                if face[row, column] >= 0:
                    counts[tile_row, column // side] += 1


@numba.njit(cache=True, parallel=True)
def _place(face: np.ndarray, side: int, start: np.ndarray, flat: np.ndarray) -> None:
    rows, columns = face.shape
    for tile_row in numba.prange(start.shape[0]):
        for tile_column in range(start.shape[1]):
            at = start[tile_row, tile_column]
            for row in range(tile_row * side, min((tile_row + 1) * side, rows)):
                for column in range(tile_column * side, min((tile_column + 1) * side, columns)):
                    if face[row, column] >= 0:
                        flat[at] = row * columns + column
                        at += 1
