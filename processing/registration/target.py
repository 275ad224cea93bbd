"""The scan as a target: closest points, their normals, and whether they are on its border."""

from __future__ import annotations

import dataclasses

import numpy as np
import open3d

from lightstage.formats.mesh import Mesh, edge_counts, vertex_normals
from processing.rays import MeshRays
from processing.registration.laplacian import neighbour_mean
from processing.registration.sky import sky_share


@dataclasses.dataclass(frozen=True)
class Closest:
    """Closest points on a surface, one a query.

    Attributes:
        point: (n, 3) mm.
        normal: (n, 3) unit, interpolated from the vertices; zero on degenerate triangles.
        distance_mm: (n,).
        border: (n,) the closest point is on the surface's open border.
    """

    point: np.ndarray
    normal: np.ndarray
    distance_mm: np.ndarray
    border: np.ndarray


class Target:
    """A triangle mesh prepared for closest-point queries."""

    def __init__(self, mesh: Mesh) -> None:
        """Build the hierarchy; degenerate triangles are left out."""
        triangles = mesh.triangles()
        corners = mesh.vertices[triangles]
        area = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        self.vertices = mesh.vertices
        self.triangles = triangles[area > 0]
        self.normals = vertex_normals(mesh.vertices, self.triangles)
        self._border = border_vertices(self.triangles, len(self.vertices))
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            open3d.core.Tensor(np.ascontiguousarray(self.vertices, np.float32)),
            open3d.core.Tensor(np.ascontiguousarray(self.triangles, np.uint32)),
        )
        self._rays: MeshRays | None = None

    def border_points(self) -> np.ndarray:
        """(b, 3) mm: vertices of the surface's open borders."""
        return self.vertices[self._border]

    def sky(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(n,) share of all directions that (n, 3) points of the surface see."""
        if self._rays is None:
            self._rays = MeshRays(self.vertices, self.triangles)
        return sky_share(self._rays, points, normals)

    def noise_mm(self) -> float:
        """Standard deviation of the vertices' noise along their normals, mm.

        From the median distance of a vertex to the mean of its neighbours; relief as fine as the
        triangles counts as noise.
        """
        if not len(self.triangles):
            return 0.0
        used = np.unique(self.triangles)
        mean = neighbour_mean(self.triangles, len(self.vertices))[used] @ self.vertices
        away = np.einsum("nk,nk->n", self.vertices[used] - mean, self.normals[used])
        # A median is .6745 deviations; the mean of six neighbours has noise of its own.
        return float(np.median(np.abs(away - np.median(away)))) / (0.6745 * (1 + 1 / 6) ** 0.5)

    def on(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Triangle (n,) of `triangles` and weights (n, 3) of its corners, of the closest points."""
        query = open3d.core.Tensor(np.ascontiguousarray(points, np.float32))
        found = self._scene.compute_closest_points(query)
        uv = found["primitive_uvs"].numpy().astype(float)
        weight = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
        return found["primitive_ids"].numpy().astype(np.int64), weight

    def closest(self, points: np.ndarray) -> Closest:
        """Closest points to (n, 3) queries."""
        face, weight = self.on(points)
        corner = self.triangles[face]
        # Recomputed in float64: Open3D's own point has float32's 1e-4 mm steps.
        point = np.einsum("nck,nc->nk", self.vertices[corner], weight)
        normal = np.einsum("nck,nc->nk", self.normals[corner], weight)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-12)
        # On the border when every corner that carries weight is a border vertex.
        border = ((weight > 1e-4) <= self._border[corner]).all(axis=1)
        return Closest(point, normal, np.linalg.norm(point - points, axis=1), border)


def border_vertices(triangles: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: vertices on an edge that a single triangle has."""
    edges, times = edge_counts(triangles)
    border = np.zeros(count, bool)
    border[edges[times == 1]] = True
    return border
