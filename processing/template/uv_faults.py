"""What is wrong with a template's texture coordinates: overlaps, mirrored islands, stretch."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from lightstage.formats.mesh import Mesh, connected, directed_edges
from processing.closest import weighted_quantile

INSIDE = 1e-6
"""Of a triangle's height: a texel so near its edge is the neighbour's as well."""


@dataclasses.dataclass(frozen=True)
class Stretch:
    """How a texture distorts a surface, one entry a triangle.

    Attributes:
        angle_deg: (t,) largest change of an angle, 2 asin((a - b) / (a + b)) for the singular
            values a >= b of the map from surface to texels [Snyder1987]; NaN without area.
        texel_mm: (t,) side of a texel on the surface, the root of the areas' ratio; infinite where
            the triangle has no area in the texture.
        area_mm2: (t,) of the surface.
    """

    angle_deg: np.ndarray
    texel_mm: np.ndarray
    area_mm2: np.ndarray

    def of(self, chosen: np.ndarray, share: float) -> tuple[float, float, float]:
        """Over some triangles, weighted by their area: angle, area, and a texel's side.

        Args:
            chosen: (t,) bool.
            share: of the area that is distorted less, such as .95.

        Returns:
            Degrees; how many times more or fewer texels than the median, at least 1; the median
            texel's side in mm. NaN where nothing chosen has an area in the texture.
        """
        used = chosen & np.isfinite(self.angle_deg) & np.isfinite(self.texel_mm)
        weight = self.area_mm2[used]
        if not weight.sum() > 0:
            return np.nan, np.nan, np.nan
        middle = weighted_quantile(self.texel_mm[used], weight, 0.5)
        times = (self.texel_mm[used] / middle) ** 2
        area = weighted_quantile(np.maximum(times, 1 / times), weight, share)
        return weighted_quantile(self.angle_deg[used], weight, share), area, middle


def stretch_of(mesh: Mesh, rows: int) -> Stretch:
    """How a mesh's UV distorts it in a texture of `rows` x two thirds of that.

    Raises:
        FormatError: no UV.
    """
    flat = _texels(mesh, rows, rows * 2 // 3)
    corners = mesh.vertices[mesh.triangles()]
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(along, axis=1)
    double = np.linalg.norm(np.cross(along, across), axis=1)
    ok = (length > 0) & (double > 0)
    safe = np.where(ok, length, 1.0)
    # The triangle in a plane: (0, 0), (length, 0), (x, y).
    x = np.einsum("tk,tk->t", along, across) / safe
    y = np.where(ok, double, 1.0) / safe
    first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    by_x = first / safe[:, None]
    by_y = (second - by_x * x[:, None]) / y[:, None]
    # Singular values of the 2 x 2 matrix with these columns.
    trace = (by_x**2).sum(axis=1) + (by_y**2).sum(axis=1)
    det = np.abs(by_x[:, 0] * by_y[:, 1] - by_x[:, 1] * by_y[:, 0])
    plus, minus = np.sqrt(trace + 2 * det), np.sqrt(np.maximum(trace - 2 * det, 0))
    ratio = np.divide(minus, plus, out=np.ones_like(plus), where=plus > 0)
    angle = np.rad2deg(2 * np.arcsin(np.clip(ratio, 0, 1)))
    angle[~ok] = np.nan
    texel = np.full(len(det), np.inf)
    np.divide(1.0, np.sqrt(det), out=texel, where=det > 0)
    return Stretch(angle, texel, double / 2)


def overlapping(mesh: Mesh, rows: int) -> tuple[np.ndarray, float]:
    """Triangles whose texels other triangles have, too.

    Args:
        mesh: with UV.
        rows: of the texture that is checked; columns are two thirds.

    Returns:
        (t,) bool, and the share of all covered texels that more than one triangle has.
    """
    columns = rows * 2 // 3
    flat = _texels(mesh, rows, columns)
    count = np.zeros((rows, columns), np.uint8)
    _count(flat, count)
    shared = np.zeros(len(flat), np.bool_)
    _shared(flat, count, shared)
    covered = int((count > 0).sum())
    return shared, float((count > 1).sum() / covered) if covered else 0.0


def islands(mesh: Mesh) -> np.ndarray:
    """(t,) number of the UV island that each triangle is in."""
    corners = mesh.triangle_uvs()
    assert mesh.uvs is not None  # triangle_uvs has checked it
    # Equal coordinates that a file writes twice are one place only where a vertex is shared, too.
    key = np.concatenate([mesh.triangles().reshape(-1, 1), mesh.uvs[corners].reshape(-1, 2)], 1)
    _, place = np.unique(np.round(key, 9), axis=0, return_inverse=True)
    joined = place.reshape(-1, 3)
    label = connected(directed_edges(joined), int(joined.max()) + 1)
    return np.unique(label[joined[:, 0]], return_inverse=True)[1]


def mirrored(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which triangles the texture shows mirrored, and which have no area in it.

    Returns:
        (t,) bool triangles of islands that are mirrored as wholes; (t,) bool triangles that are
        turned over within their island; (t,) bool triangles without area in the texture.
    """
    flat = _texels(mesh, 3, 2)
    first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    # Texel rows run downward: what winds alike on surface and texture has a negative area here.
    area = -(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    island = islands(mesh)
    whole = np.bincount(island, weights=area) < 0
    over = np.where(whole[island], area > 0, area < 0)
    return whole[island], over, area == 0


def _texels(mesh: Mesh, rows: int, columns: int) -> np.ndarray:
    """(t, 3, 2) float64 places of the triangles' corners, x right and y down, in texels."""
    corners = mesh.triangle_uvs()
    assert mesh.uvs is not None  # triangle_uvs has checked it
    uv = mesh.uvs[corners]
    return np.ascontiguousarray(np.stack([uv[..., 0] * columns, (1 - uv[..., 1]) * rows], axis=-1))


@numba.njit(cache=True)
def _count(corners: np.ndarray, count: np.ndarray) -> None:
    rows, columns = count.shape
    for t in range(len(corners)):
        top, bottom, left, right, area = _box(corners[t], rows, columns)
        if not abs(area) > 0:
            continue
        for row in range(top, bottom):
            for column in range(left, right):
                if count[row, column] < 255 and _holds(corners[t], area, column + 0.5, row + 0.5):
                    count[row, column] += 1


@numba.njit(cache=True)
def _shared(corners: np.ndarray, count: np.ndarray, shared: np.ndarray) -> None:
    rows, columns = count.shape
    for t in range(len(corners)):
        top, bottom, left, right, area = _box(corners[t], rows, columns)
        if not abs(area) > 0:
            continue
        for row in range(top, bottom):
            for column in range(left, right):
                if count[row, column] > 1 and _holds(corners[t], area, column + 0.5, row + 0.5):
                    shared[t] = True


@numba.njit(cache=True)
def _box(corner: np.ndarray, rows: int, columns: int) -> tuple[int, int, int, int, float]:
    top = max(0, int(np.floor(min(corner[0, 1], corner[1, 1], corner[2, 1]) - 0.5)))
    bottom = min(rows, int(np.ceil(max(corner[0, 1], corner[1, 1], corner[2, 1]) - 0.5)) + 1)
    left = max(0, int(np.floor(min(corner[0, 0], corner[1, 0], corner[2, 0]) - 0.5)))
    right = min(columns, int(np.ceil(max(corner[0, 0], corner[1, 0], corner[2, 0]) - 0.5)) + 1)
    area = (corner[1, 0] - corner[0, 0]) * (corner[2, 1] - corner[0, 1]) - (
        corner[2, 0] - corner[0, 0]
    ) * (corner[1, 1] - corner[0, 1])
    return top, bottom, left, right, area


@numba.njit(cache=True)
def _holds(corner: np.ndarray, area: float, x: float, y: float) -> bool:
    """Whether a point is within a triangle and off its edges."""
    for k in range(3):
        a, b = corner[k], corner[(k + 1) % 3]
        if ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area <= INSIDE:
            return False
    return True
