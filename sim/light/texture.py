"""Textures of a mesh: UV rasteriser, bilinear sampling, tangent frames."""

from __future__ import annotations

import numba
import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals


@numba.njit(cache=True)
def _raster(
    corners: np.ndarray, rows: int, columns: int, face: np.ndarray, weights: np.ndarray
) -> None:
    """Fill `face` (rows, columns) and `weights` (.., 3) from (t, 3, 2) UV in texel units."""
    for t in range(len(corners)):
        ax, ay = corners[t, 0]
        bx, by = corners[t, 1]
        cx, cy = corners[t, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-12:
            continue
        low_x = max(0, int(np.ceil(min(ax, bx, cx) - 0.5)))
        high_x = min(columns - 1, int(np.floor(max(ax, bx, cx) - 0.5)))
        low_y = max(0, int(np.ceil(min(ay, by, cy) - 0.5)))
        high_y = min(rows - 1, int(np.floor(max(ay, by, cy) - 0.5)))
        for row in range(low_y, high_y + 1):
            y = row + 0.5
            for column in range(low_x, high_x + 1):
                x = column + 0.5
                wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                wc = 1.0 - wa - wb
                if min(wa, wb, wc) >= -1e-9:
                    face[row, column] = t
                    weights[row, column, 0] = wa
                    weights[row, column, 1] = wb
                    weights[row, column, 2] = wc


def raster_uv(mesh: Mesh, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Which triangle covers each texel centre.

    Args:
        mesh: with UV.
        rows: of the texture.
        columns: of the texture.

    Returns:
        (rows, columns) int32 triangle index, -1 where none, and (rows, columns, 3) float32
        barycentric weights. Where triangles overlap the last one stays.
    """
    return raster_rows(mesh, rows, columns, 0, rows)


def raster_rows(
    mesh: Mesh, rows: int, columns: int, first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rows `first` to `last` of what `raster_uv` returns."""
    assert mesh.uvs is not None
    corners = mesh.uvs[mesh.triangle_uvs()]
    down = (1.0 - corners[..., 1]) * rows - first
    corners = np.stack([corners[..., 0] * columns, down], axis=-1)
    height = last - first
    face = np.full((height, columns), -1, np.int32)
    weights = np.zeros((height, columns, 3), np.float32)
    _raster(corners, height, columns, face, weights)
    return face, weights


def texture_of(
    values: np.ndarray, triangles: np.ndarray, face: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Per-vertex values on texels.

    Args:
        values: (n, k) per vertex.
        triangles: (t, 3).
        face: (rows, columns) from `raster_uv`.
        weights: (rows, columns, 3) from `raster_uv`.

    Returns:
        (rows, columns, k) float32, zero where no triangle is.
    """
    out = np.zeros((*face.shape, values.shape[1]), np.float32)
    covered = face >= 0
    corners = triangles[face[covered]]
    for corner in range(3):
        out[covered] += weights[covered][:, corner, None] * values[corners[:, corner]]
    return out


@numba.njit(cache=True, parallel=True)
def _bilinear(image: np.ndarray, uvs: np.ndarray, out: np.ndarray) -> None:
    rows, columns, channels = image.shape
    for i in numba.prange(len(uvs)):
        x = min(max(uvs[i, 0] * columns - 0.5, 0.0), columns - 1.0)
        y = min(max((1.0 - uvs[i, 1]) * rows - 0.5, 0.0), rows - 1.0)
        column, row = int(x), int(y)
        fx, fy = x - column, y - row
        right, below = min(column + 1, columns - 1), min(row + 1, rows - 1)
        for k in range(channels):
            top = image[row, column, k] * (1 - fx) + image[row, right, k] * fx
            bottom = image[below, column, k] * (1 - fx) + image[below, right, k] * fx
            out[i, k] = top * (1 - fy) + bottom * fy


def sample(image: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Bilinear samples, clamped at the border.

    Args:
        image: (rows, columns) or (rows, columns, k).
        uvs: (n, 2) OBJ texture coordinates, v upward.

    Returns:
        (n,) or (n, k) float32.
    """
    pixels = np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None], np.float32)
    out = np.zeros((len(uvs), pixels.shape[2]), np.float32)
    _bilinear(pixels, np.ascontiguousarray(uvs, np.float64), out)
    return out if image.ndim == 3 else out[:, 0]


def tangent_frames(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tangent (along u), bitangent (along v, upward) and normal of each corner of each triangle.

    Tangents are averaged over the triangles that share both a vertex and its UV, then made
    orthogonal to the vertex normal, so that a seam or a mirrored chart keeps its own frame.

    Returns:
        Three (t, 3, 3) float64 arrays of unit vectors (corner, axis).
    """
    assert mesh.uvs is not None
    triangles, uv_triangles = mesh.triangles(), mesh.triangle_uvs()
    points, uvs = mesh.vertices[triangles], mesh.uvs[uv_triangles]
    e1, e2 = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    d1, d2 = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    # Cramer's rule without the division by the determinant: directions keep its sign alone.
    sign = np.sign(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])[:, None]
    along_u = _unit((e1 * d2[:, 1:] - e2 * d1[:, 1:]) * sign)
    along_v = _unit((e2 * d1[:, :1] - e1 * d2[:, :1]) * sign)
    normal = vertex_normals(mesh.vertices, triangles)[triangles]
    frames = []
    for direction in (along_u, along_v):
        summed = np.zeros((len(mesh.uvs), 3))
        for corner in range(3):
            np.add.at(summed, uv_triangles[:, corner], direction)
        corners = summed[uv_triangles]
        corners -= normal * np.sum(corners * normal, axis=-1, keepdims=True)
        frames.append(_unit(corners))
    return frames[0], frames[1], normal


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 1e-20)
