"""A mesh laid out in its texture: which triangle each texel shows."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np
from scipy import ndimage

from learning.vectors import unit
from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh, vertex_normals
from processing.atlas.raster import rasterise as atlas_raster


@dataclasses.dataclass(frozen=True)
class UvRaster:
    """Texels of a mesh.

    Attributes:
        face: (rows, columns) int32 triangle, -1 where the texture holds no surface.
        barycentric: (rows, columns, 3) float32 weights of its corners.
        triangles: (t, 3) vertex indices.
    """

    face: np.ndarray
    barycentric: np.ndarray
    triangles: np.ndarray

    @property
    def covered(self) -> np.ndarray:
        """(rows, columns) bool, texels whose centre is in a triangle."""
        return self.face >= 0

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """Per-vertex (n, k) values at texels: (rows, columns, k) float32, zero outside."""
        out = np.zeros((*self.face.shape, values.shape[1]), np.float32)
        triangles = np.ascontiguousarray(self.triangles, np.int32)
        _mixed(self.face, self.barycentric, triangles, np.ascontiguousarray(values, float), out)
        return out

    def normals(self, mesh: Mesh) -> np.ndarray:
        """(rows, columns, 3) unit interpolated vertex normals of the mesh, zero outside."""
        return unit(self.interpolate(vertex_normals(mesh.vertices, self.triangles)))


@numba.njit(cache=True)
def _mixed(
    face: np.ndarray,
    barycentric: np.ndarray,
    triangles: np.ndarray,
    values: np.ndarray,
    out: np.ndarray,
) -> None:
    rows, columns = face.shape
    for row in range(rows):
        for column in range(columns):
            t = face[row, column]
            if t < 0:
                continue
            b0, b1, b2 = barycentric[row, column]
            i, j, m = triangles[t]
            for k in range(values.shape[1]):
                out[row, column, k] = b0 * values[i, k] + b1 * values[j, k] + b2 * values[m, k]


def rasterise(mesh: Mesh, rows: int, columns: int) -> UvRaster:
    """Find each texel's triangle, as the atlas does it: of triangles that overlap the first counts.

    Raises:
        FormatError: no UV, or none inside the 0..1 tile.
    """
    corner_uvs = mesh.triangle_uvs()
    if mesh.uvs is None:
        raise FormatError("mesh", field="uv", found="none", expected="texture coordinates")
    found = atlas_raster(mesh.uvs, corner_uvs, rows, columns)
    if (found.face < 0).all():
        raise FormatError("mesh", field="uv", found="no texel covered", expected="UV in 0..1")
    barycentric = np.empty((rows, columns, 3), np.float32)
    barycentric[..., 1:] = found.barycentric
    barycentric[..., 0] = (found.face >= 0) - found.barycentric[..., 0] - found.barycentric[..., 1]
    return UvRaster(found.face, barycentric, mesh.triangles())


def spread_outside(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill texels that are not known with the nearest known one, so that sampling shows no seam.

    Args:
        image: (rows, columns, ...).
        known: (rows, columns) bool; where none is, the image comes back as it is.
    """
    if known.all() or not known.any():
        return image
    return image[nearest_known(known)]


def nearest_known(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns, (rows, columns) int32 each, of the known texel that is nearest to each."""
    rows, columns = ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    return rows, columns


@dataclasses.dataclass(frozen=True)
class TexelSurface:
    """Normals and areas of a position map's surface.

    Attributes:
        normal: (rows, columns, 3) float32 unit, outward for unmirrored UV; zero outside.
        area_mm2: (rows, columns) float32 of a texel, zero outside.
        edges_mm: (rows, columns, 2) float32, how far its neighbours across and down are; zero
            outside.
    """

    normal: np.ndarray
    area_mm2: np.ndarray
    edges_mm: np.ndarray


def texel_surface(
    position_mm: np.ndarray, covered: np.ndarray, smooth_px: float = 2.0
) -> TexelSurface:
    """Normals and texel areas from a position map, by differences between neighbours.

    Differences across a seam of the texture (ten times the median step) do not count. The tangents
    are smoothed, so that a mesh's facets do not show.

    Args:
        position_mm: (rows, columns, 3).
        covered: (rows, columns) bool.
        smooth_px: standard deviation of the smoothing in texels.
    """
    across = _tangent(position_mm, covered, 1, smooth_px)
    down = _tangent(position_mm, covered, 0, smooth_px)
    # Rows run against v, so du x dv = -(across x down).
    cross = np.cross(down, across)
    area = np.linalg.norm(cross, axis=2)
    normal = np.divide(cross, area[..., None], out=np.zeros_like(cross), where=area[..., None] > 0)
    edges = np.stack([np.linalg.norm(across, axis=2), np.linalg.norm(down, axis=2)], axis=2)
    return TexelSurface(normal, area, edges)


def grid_quads(position_mm: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Quads between neighbouring texels of a position map, without those across a seam.

    Across a seam of the texture neighbours are far apart on the face: a quad whose longest edge is
    ten times the median of all quads' or more is left out.

    Args:
        position_mm: (rows, columns, 3).
        covered: (rows, columns) bool.

    Returns:
        (n, 4) indices of texels, row by row: top left, bottom left, bottom right, top right.
    """
    index = np.arange(covered.size).reshape(covered.shape)
    corners = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1)
    corners = corners[covered.ravel()[corners].all(axis=-1)]
    points = position_mm.reshape(-1, 3)[corners]
    longest = np.linalg.norm(points - points[:, [1, 2, 3, 0]], axis=2).max(axis=1)
    quads: np.ndarray = corners[longest < 10 * np.median(longest)]
    return quads


def _tangent(position: np.ndarray, covered: np.ndarray, axis: int, smooth_px: float) -> np.ndarray:
    step = np.diff(position.astype(np.float32), axis=axis)
    both = np.logical_and(*(np.delete(covered, end, axis=axis) for end in (0, -1)))
    length = np.linalg.norm(step, axis=2)
    typical = float(np.median(length[both])) if both.any() else 0.0
    valid = (both & (length < 10 * typical)).astype(np.float32)
    # A difference is between two texels; each gets half of it.
    total = np.zeros((*covered.shape, 4), np.float32)
    packed = np.concatenate([step * valid[..., None], valid[..., None]], axis=2)
    first = [slice(None)] * 3
    second = [slice(None)] * 3
    first[axis], second[axis] = slice(0, -1), slice(1, None)
    total[tuple(first)] += packed
    total[tuple(second)] += packed
    for channel in range(4):
        total[..., channel] = ndimage.gaussian_filter(total[..., channel], smooth_px, truncate=3)
    weight = total[..., 3:]
    tangent = np.divide(
        total[..., :3], weight, out=np.zeros_like(total[..., :3]), where=weight > 1e-6
    )
    return tangent * covered[..., None]
