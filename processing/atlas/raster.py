"""UV rasteriser: which triangle each texel of the atlas shows, and where in it."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

BAND_ROWS = 64
"""Rows that one thread fills; small enough to share, large enough to amortise the face scan."""


@dataclasses.dataclass(frozen=True)
class Raster:
    """Texels of an atlas.

    Attributes:
        face: (rows, columns) int32 triangle, -1 in the gutter.
        barycentric: (rows, columns, 2) float32 weights of the triangle's second and third corner,
            none below 0 and both together at most 1.
    """

    face: np.ndarray
    barycentric: np.ndarray

    def texels(self) -> np.ndarray:
        """(k,) int32 flat indices of the texels that show a triangle, in row order."""
        return np.flatnonzero(self.face.ravel() >= 0).astype(np.int32)

    def at(
        self, values: np.ndarray, triangles: np.ndarray, texels: np.ndarray | None = None
    ) -> np.ndarray:
        """Per-vertex values at texels.

        Args:
            values: (v, c) per vertex.
            triangles: (t, 3) in the order that was rasterised.
            texels: (k,) flat indices of covered texels; all of them by default.

        Returns:
            (k, c) float32.
        """
        chosen = self.texels() if texels is None else texels
        out = np.empty((len(chosen), values.shape[1]), np.float32)
        _interpolate(
            self.face.ravel(),
            self.barycentric.reshape(-1, 2),
            chosen,
            np.ascontiguousarray(triangles, np.int32),
            np.ascontiguousarray(values, np.float64),
            out,
        )
        return out


def rasterise(uvs: np.ndarray, triangle_uvs: np.ndarray, rows: int, columns: int) -> Raster:
    """Fill the UV tile: a texel belongs to the first triangle that holds its centre.

    Row 0 is v = 1, texel centres are at half-integers. A centre on a shared edge goes to the
    triangle of the lower index; degenerate triangles hold nothing; triangles may wind either way.

    Args:
        uvs: (k, 2) OBJ texture coordinates in 0..1.
        triangle_uvs: (t, 3) indices into them.
        rows: of the atlas.
        columns: of the atlas.

    Returns:
        Raster.
    """
    corners = np.empty((len(triangle_uvs), 3, 2))
    corners[:, :, 0] = uvs[triangle_uvs, 0] * columns
    corners[:, :, 1] = (1.0 - uvs[triangle_uvs, 1]) * rows
    face = np.full((rows, columns), -1, np.int32)
    barycentric = np.zeros((rows, columns, 2), np.float32)
    _fill(corners, face, barycentric)
    return Raster(face, barycentric)


@numba.njit(cache=True, parallel=True)
def _fill(corners: np.ndarray, face: np.ndarray, barycentric: np.ndarray) -> None:
    rows, columns = face.shape
    bands = (rows + BAND_ROWS - 1) // BAND_ROWS
    for band in numba.prange(bands):
        top, bottom = band * BAND_ROWS, min((band + 1) * BAND_ROWS, rows)
        for t in range(len(corners)):
            x0, y0 = corners[t, 0]
            x1, y1 = corners[t, 1]
            x2, y2 = corners[t, 2]
            first = max(top, int(np.floor(min(y0, y1, y2) - 0.5)))
            last = min(bottom, int(np.ceil(max(y0, y1, y2) - 0.5)) + 1)
            if first >= last:
                continue
            double_area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            if not abs(double_area) > 0:  # also where UV is NaN
                continue
            left = max(0, int(np.floor(min(x0, x1, x2) - 0.5)))
            right = min(columns, int(np.ceil(max(x0, x1, x2) - 0.5)) + 1)
            for row in range(first, last):
                y = row + 0.5
                for column in range(left, right):
                    if face[row, column] >= 0:
                        continue
                    x = column + 0.5
                    # Edge functions from the lower-placed corner, so that both triangles of an
                    # edge compute the same number and no centre on it falls between them.
                    b0 = _edge(x1, y1, x2, y2, x, y) / double_area
                    b1 = _edge(x2, y2, x0, y0, x, y) / double_area
                    b2 = _edge(x0, y0, x1, y1, x, y) / double_area
                    if b0 >= 0 and b1 >= 0 and b2 >= 0:
                        face[row, column] = t
                        barycentric[row, column] = _single(b1, b2)


@numba.njit(cache=True)
def _single(b1: float, b2: float) -> tuple[np.float32, np.float32]:
    """Two weights in single precision, which together are still at most 1.

    Both rounded up, they would leave the first corner less than nothing, and what is interpolated
    between black and white would fall below black.
    """
    first, second = np.float32(b1), np.float32(b2)
    if 1.0 - first - second < 0:
        if first > second:
            first = np.nextafter(first, np.float32(0))
        else:
            second = np.nextafter(second, np.float32(0))
    return first, second


@numba.njit(cache=True, inline="always")
def _edge(ax: float, ay: float, bx: float, by: float, x: float, y: float) -> float:
    """Twice the signed area of (a, b, point), bit for bit antisymmetric in a and b."""
    if (ax, ay) <= (bx, by):
        return (bx - ax) * (y - ay) - (by - ay) * (x - ax)
    return -((ax - bx) * (y - by) - (ay - by) * (x - bx))


@numba.njit(cache=True, parallel=True)
def _interpolate(
    face: np.ndarray,
    barycentric: np.ndarray,
    texels: np.ndarray,
    triangles: np.ndarray,
    values: np.ndarray,
    out: np.ndarray,
) -> None:
    for k in numba.prange(len(texels)):
        texel = texels[k]
        t = face[texel]
        b1, b2 = barycentric[texel, 0], barycentric[texel, 1]
        b0 = 1.0 - b1 - b2
        i, j, m = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for c in range(values.shape[1]):
            out[k, c] = b0 * values[i, c] + b1 * values[j, c] + b2 * values[m, c]


def overlap_share(uvs: np.ndarray, triangle_uvs: np.ndarray, raster: Raster) -> float:
    """Share of the triangles' area in UV that other triangles cover too or that is off the tile.

    Args:
        uvs: (k, 2).
        triangle_uvs: (t, 3) indices into them.
        raster: of these triangles.

    Returns:
        0..1, right to about a texel along the islands' outline.
    """
    rows, columns = raster.face.shape
    flat = uvs[triangle_uvs] * [columns, rows]
    e1, e2 = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = 0.5 * float(np.nansum(np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])))
    covered = int((raster.face >= 0).sum())
    return max(0.0, 1.0 - covered / area) if area > 0 else 0.0


def texel_size_mm(
    vertices: np.ndarray,
    triangles: np.ndarray,
    uvs: np.ndarray,
    triangle_uvs: np.ndarray,
    rows: int,
    columns: int,
) -> np.ndarray:
    """Side of a texel on the surface, mm, for each triangle: the root of its areas' ratio.

    Returns:
        (t,) float64, infinite where the triangle has no area in UV.
    """
    corners = vertices[triangles]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    flat = uvs[triangle_uvs] * [columns, rows]
    e1, e2 = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    texels = np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
    ratio = np.divide(area, texels, out=np.full(len(area), np.inf), where=texels > 0)
    size: np.ndarray = np.sqrt(ratio)
    return size
