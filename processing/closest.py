"""Closest points on a mesh (Embree through Open3D), and values there."""

from __future__ import annotations

import dataclasses

import numpy as np

from processing import late_open3d as open3d


@dataclasses.dataclass(frozen=True)
class Closest:
    """Closest points; fields hold one entry a query.

    Attributes:
        point_mm: (n, 3) float32 on the surface.
        distance_mm: (n,) float32.
        face: (n,) int32 triangle index.
        barycentric: (n, 3) float32 weights of the triangle's corners.
    """

    point_mm: np.ndarray
    distance_mm: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray


class ClosestPoints:
    """A mesh prepared for closest-point queries."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        """Build the hierarchy over (n, 3) vertices in mm and (t, 3) triangles."""
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            open3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
            open3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    def query(self, points_mm: np.ndarray) -> Closest:
        """The closest surface points to (n, 3) finite points in mm."""
        queries = np.ascontiguousarray(points_mm, np.float32).reshape(-1, 3)
        found = self._scene.compute_closest_points(open3d.core.Tensor(queries))
        point = found["points"].numpy()
        uv = found["primitive_uvs"].numpy()
        return Closest(
            point,
            np.linalg.norm(point - queries, axis=1),
            found["primitive_ids"].numpy().astype(np.int32),
            np.stack([1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], axis=1),
        )


def sample_texture(image: np.ndarray, covered: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear texture lookup that takes nothing from texels that hold no surface.

    Args:
        image: (rows, columns, c) float; row 0 is the top, v upward.
        covered: (rows, columns) bool, texels that hold something.
        uv: (n, 2) finite.

    Returns:
        (n, c) float64; zero where none of the four texels around is covered.
    """
    rows, columns = covered.shape
    x = np.clip(uv[:, 0] * columns - 0.5, 0, columns - 1)
    y = np.clip((1 - uv[:, 1]) * rows - 0.5, 0, rows - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    total = np.zeros((len(uv), image.shape[2]))
    weight = np.zeros((len(uv), 1))
    for down in (0, 1):
        for right in (0, 1):
            row, column = np.minimum(top + down, rows - 1), np.minimum(left + right, columns - 1)
            share = abs(1 - down - (y - top)) * abs(1 - right - (x - left))
            share = (share * covered[row, column])[:, None]
            total += share * image[row, column]
            weight += share
    return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)


def weighted_quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The smallest value that at least `share` of the weight does not exceed.

    Args:
        values: (n,), n > 0.
        weights: (n,) not negative, not all zero.
        share: 0..1.
    """
    order = np.argsort(values)
    total = np.cumsum(weights[order], dtype=float)
    index = int(np.searchsorted(total, share * total[-1]))
    return float(values[order[min(index, len(order) - 1)]])
