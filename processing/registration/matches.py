"""Which closest points of a scan may draw the mesh: gates, borders, cavities."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import vertex_normals
from processing.registration.config import GateConfig
from processing.registration.target import Closest, Target, border_vertices


@dataclasses.dataclass(frozen=True)
class Matches:
    """Closest points and what became of them.

    Attributes:
        closest: of every vertex.
        follows: (n,) bool, drawn onto the closest point's tangent plane.
        border: (b,) vertices drawn to a point of the scan's border ...
        border_mm: (b, 3) ... this one.
    """

    closest: Closest
    follows: np.ndarray
    border: np.ndarray
    border_mm: np.ndarray


class Matcher:
    """Closest points of one mesh on one scan, gated."""

    def __init__(
        self,
        triangles: np.ndarray,
        target: Target,
        hidden: np.ndarray,
        config: GateConfig,
        far_mm: np.ndarray | None = None,
    ) -> None:
        """Prepare.

        Args:
            triangles: (t, 3) of the mesh.
            target: the scan.
            hidden: (n,) bool, vertices inside cavities.
            config: settings.
            far_mm: (n,) from each vertex to the nearest landmark; zero by default.
        """
        far = np.zeros(len(hidden)) if far_mm is None else far_mm
        self._least_mm = np.maximum(config.least_mm, config.far_share * far)
        self._triangles, self._target, self._config = triangles, target, config
        self._hidden = np.flatnonzero(hidden)
        self._at = np.full((len(hidden), 3), np.inf)
        self._found: Closest | None = None
        self._sky = np.zeros(len(hidden))
        self.queried = 0
        """Vertices whose closest point was needed so far, over all rounds."""
        self.kept = 0
        """Vertices among `queried` that kept the closest point of an earlier round."""
        self._rim = np.flatnonzero(border_vertices(triangles, len(hidden)))
        self._scan_rim = target.border_points()
        self._scan_tree = cKDTree(self._scan_rim) if len(self._scan_rim) else None

    def match(self, vertices: np.ndarray, stiffness_mm: float) -> Matches:
        """Match a mesh in its present place, (n, 3) mm."""
        config = self._config
        closest = self._closest(vertices)
        facing = np.einsum("nk,nk->n", vertex_normals(vertices, self._triangles), closest.normal)
        gate = np.maximum(config.share * stiffness_mm, self._least_mm)
        follows = (closest.distance_mm < gate) & ~closest.border
        follows &= facing > np.cos(np.deg2rad(config.normal_deg))
        follows[self._hidden] &= self._sky[self._hidden] < config.cavity_sky
        border, border_mm = self._borders(vertices, config.border_share * stiffness_mm)
        return Matches(closest, follows, border, border_mm)

    def _closest(self, vertices: np.ndarray) -> Closest:
        """Closest points, found anew for what has moved since."""
        far = np.linalg.norm(vertices - self._at, axis=1) > self._config.unmoved_mm
        stale = np.flatnonzero(far)
        found = self._target.closest(vertices[stale])
        self.queried += len(vertices)
        self.kept += len(vertices) - len(stale)
        self._at[stale] = vertices[stale]
        old = self._found
        if old is None:
            self._found = old = found
        else:
            old.point[stale], old.normal[stale] = found.point, found.normal
            old.border[stale] = found.border
        inside = self._hidden[far[self._hidden]]
        if len(inside):
            self._sky[inside] = self._target.sky(old.point[inside], old.normal[inside])
        away = np.linalg.norm(old.point - vertices, axis=1)
        return Closest(old.point.copy(), old.normal.copy(), away, old.border.copy())

    def _borders(self, vertices: np.ndarray, reach_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """The mesh's border vertices and their nearest points on the scan's border."""
        if not self._config.borders or self._scan_tree is None or not len(self._rim):
            return np.zeros(0, np.int64), np.zeros((0, 3))
        distance, nearest = self._scan_tree.query(vertices[self._rim])
        goal = self._scan_rim[nearest]
        to_mesh = cKDTree(vertices).query(goal)[0]
        to_rim = cKDTree(vertices[self._rim]).query(goal)[0]
        good = (distance < reach_mm) & (to_rim <= to_mesh + reach_mm)
        return self._rim[good], goal[good]
