"""The scan as a target: closest points, normals, borders; less noise; how open its places are."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import Mesh, edge_counts, vertex_normals
from processing import late_open3d as open3d
from processing.laplacian import neighbour_mean
from processing.rays import MeshRays

MOST_OF_NOISE = 2.0
"""A vertex moves at most so many standard deviations of the noise: no relief above it is lost."""

SKY_MM, SKY_DIRECTIONS = 2000.0, 100
"""Length and number of the rays that find how open a place is."""


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


def sky_share(rays: MeshRays, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Share of a hundred even directions that no triangle blocks.

    Args:
        rays: the mesh.
        points: (n, 3) on it, mm.
        normals: (n, 3) unit, outward.

    Returns:
        (n,) in 0..1; about .5 on a convex surface.
    """
    # A Fibonacci sphere: even directions without a random number.
    index = np.arange(SKY_DIRECTIONS) + 0.5
    z = 1 - 2 * index / SKY_DIRECTIONS
    angle = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z**2)
    sky = SKY_MM * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    centre = points.mean(axis=0) if len(points) else np.zeros(3)
    share: np.ndarray = rays.visible(points, normals, centre + sky).mean(axis=1)
    return share


def quieted(scan: Mesh, rounds: int) -> Mesh:
    """The scan with its vertices moved along their normals, where they stand out from both rings.

    Each round subtracts B B v, B = (I - mean of neighbours) / 2: it takes what alternates from
    vertex to vertex and leaves what bends evenly, which one B alone would flatten [Taubin1995].

    Args:
        scan: triangles, mm.
        rounds: how often.

    Returns:
        A mesh of the same triangles; borders stay.
    """
    triangles = scan.triangles()
    target = Target(scan)
    if rounds < 1 or not len(target.triangles):
        return scan
    limit = MOST_OF_NOISE * target.noise_mm()
    mean = neighbour_mean(target.triangles, len(scan.vertices))
    stays = border_vertices(target.triangles, len(scan.vertices))
    stays[np.setdiff1d(np.arange(len(stays)), target.triangles)] = True
    normals = target.normals
    away = np.zeros(len(scan.vertices))
    for _ in range(rounds):
        moved = scan.vertices + away[:, None] * normals
        for _ in range(2):
            moved = 0.5 * (moved - mean @ moved)
        away = np.clip(away - np.einsum("nk,nk->n", moved, normals), -limit, limit)
        away[stays] = 0
    return Mesh(scan.vertices + away[:, None] * normals, triangles)
