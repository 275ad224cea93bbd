"""The atlas in square tiles: texels in an order that caches like, and what a view sees of one."""

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


@dataclasses.dataclass(frozen=True)
class TileBounds:
    """A sphere and a cone around each tile's positions and normals.

    Attributes:
        centre: (t, 3) mm.
        radius_mm: (t,).
        axis: (t, 3) unit, or zero where normals point everywhere.
        spread_rad: (t,) largest angle of a normal to the axis.
        trusted: (t,) bool, some texel's trust is above 0.
    """

    centre: np.ndarray
    radius_mm: np.ndarray
    axis: np.ndarray
    spread_rad: np.ndarray
    trusted: np.ndarray

    def seen_from(self, place_mm: np.ndarray, least_cos: float) -> np.ndarray:
        """Tiles that may hold a texel whose normal is within acos(least_cos) of the way to a place.

        Args:
            place_mm: (3,) the camera's centre.
            least_cos: of the viewing angle.

        Returns:
            (s,) int64 indices; what is left out has no such texel.
        """
        way = place_mm - self.centre
        far = np.linalg.norm(way, axis=1)
        ahead = np.einsum("tk,tk->t", way, self.axis) / np.maximum(far, 1e-9)
        # From within the sphere the way may point anywhere.
        swing = np.where(far > self.radius_mm, self.radius_mm / np.maximum(far, 1e-9), 1.0)
        slack = self.spread_rad + np.arcsin(swing) + np.arccos(np.clip(least_cos, -1, 1))
        angle = np.arccos(np.clip(ahead, -1, 1))
        # A thousandth of a radian covers what float32 rounds.
        everywhere = (far <= self.radius_mm) | ~self.axis.any(axis=1)
        return np.flatnonzero(self.trusted & (everywhere | (angle < slack + 1e-3)))


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


def bound(
    start: np.ndarray, positions: np.ndarray, normals: np.ndarray, trust: np.ndarray
) -> TileBounds:
    """Bounds of each tile.

    Args:
        start: (t + 1,) of `Tiles`.
        positions: (k, 3) mm.
        normals: (k, 3) unit.
        trust: (k,).
    """
    count = len(start) - 1
    out = TileBounds(
        np.zeros((count, 3)),
        np.zeros(count),
        np.zeros((count, 3)),
        np.zeros(count),
        np.zeros(count, np.bool_),
    )
    _bound(
        start,
        positions,
        normals,
        trust,
        out.centre,
        out.radius_mm,
        out.axis,
        out.spread_rad,
        out.trusted,
    )
    return out


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


@numba.njit(cache=True, parallel=True)
def _bound(
    start: np.ndarray,
    positions: np.ndarray,
    normals: np.ndarray,
    trust: np.ndarray,
    centre: np.ndarray,
    radius: np.ndarray,
    axis: np.ndarray,
    spread: np.ndarray,
    trusted: np.ndarray,
) -> None:
    for t in numba.prange(len(start) - 1):
        first, last = start[t], start[t + 1]
        for k in range(first, last):
            for c in range(3):
                centre[t, c] += positions[k, c]
                axis[t, c] += normals[k, c]
            trusted[t] = trusted[t] or trust[k] > 0
        length = np.sqrt(axis[t, 0] ** 2 + axis[t, 1] ** 2 + axis[t, 2] ** 2)
        for c in range(3):
            centre[t, c] /= last - first
            axis[t, c] = axis[t, c] / length if length > 1e-6 * (last - first) else 0.0
        farthest, least = 0.0, 1.0
        for k in range(first, last):
            away, along = 0.0, 0.0
            for c in range(3):
                away += (positions[k, c] - centre[t, c]) ** 2
                along += normals[k, c] * axis[t, c]
            farthest = max(farthest, away)
            least = min(least, along)
        radius[t] = np.sqrt(farthest)
        spread[t] = np.arccos(max(min(least, 1.0), -1.0))
