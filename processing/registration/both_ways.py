"""Closest points both ways, in place and direction: how what is thin and folded, ears, is drawn.

What a scan has beyond a rim or down a groove is no vertex's closest point, and a thin sheet's front
is as near as its back. So a fit that matches the mesh's vertices alone presses ears flat. Here the
scan's points are matched as well, and a turned normal counts as a distance.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import vertex_normals
from processing.registration.config import BothWaysConfig
from processing.registration.plate import Springs
from processing.registration.target import Target

_SIDES = 4
LATTICE = np.array(
    [(i, j, _SIDES - i - j) for i in range(_SIDES + 1) for j in range(_SIDES + 1 - i)], float
)
LATTICE /= _SIDES
"""(15, 3) weights of a triangle's corners: its points to which the scan's points are matched."""


class BothWays:
    """A part of a mesh and the scan's points around it."""

    def __init__(
        self,
        rest: np.ndarray,
        triangles: np.ndarray,
        chosen: np.ndarray,
        areas: np.ndarray,
        target: Target,
        config: BothWaysConfig,
    ) -> None:
        """Prepare.

        Args:
            rest: (n, 3) mm; the chosen part is within `around_mm` of the scan's.
            triangles: (t, 3).
            chosen: (n,) bool.
            areas: (n,) mm^2 of each vertex.
            target: the scan.
            config: settings.
        """
        self.vertices = np.flatnonzero(chosen)
        """Indices of the part's vertices."""
        self._config, self._triangles, self._areas = config, triangles, areas
        # Faces on the part's rim count: else points beside it would be drawn to its last row.
        self._faces = triangles[chosen[triangles].any(axis=1)]
        used = np.unique(target.triangles)
        if len(self.vertices):
            away, _ = cKDTree(rest[self.vertices]).query(
                target.vertices[used], distance_upper_bound=config.around_mm
            )
            used = used[np.isfinite(away)]
        else:
            used = used[:0]
        self._points, self._normals = target.vertices[used], target.normals[used]
        self._point_areas = vertex_areas(target.vertices, target.triangles)[used]

    def draw(
        self, springs: Springs, rest: np.ndarray, moved: np.ndarray, stiffness_mm: float
    ) -> None:
        """Add springs to what the part is closest to, and from what is closest to it.

        A scan's point draws a place within a triangle. Its spring is handed to the corners by their
        weights, each with the whole way to go: by the square's convexity their energy is above the
        place's own and touches it where the mesh is, so what lowers it lowers that.

        Args:
            springs: are changed.
            rest: (n, 3) mm.
            moved: (n, 3) mm, displacements so far.
            stiffness_mm: of this round.
        """
        config, own = self._config, self.vertices
        if not len(self._points) or stiffness_mm > config.from_mm:
            return
        radian = float(np.clip(stiffness_mm, *config.radian_mm))
        here = rest + moved
        normals = vertex_normals(here, self._triangles)
        scan = np.concatenate([self._points, radian * self._normals], axis=1)

        ask = np.concatenate([here[own], radian * normals[own]], axis=1)
        there = cKDTree(scan).query(ask)[1]
        away, facing = self._points[there] - here[own], self._normals[there]
        good = self._believed(away, facing, normals[own], stiffness_mm)
        self._pull(
            springs, own[good], self._areas[own[good]], facing[good], away[good], moved[own[good]]
        )

        at = np.einsum("wc,fck->fwk", LATTICE, here[self._faces]).reshape(-1, 3)
        smooth = np.einsum("wc,fck->fwk", LATTICE, normals[self._faces]).reshape(-1, 3)
        smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
        there = cKDTree(np.concatenate([at, radian * smooth], axis=1)).query(scan)[1]
        away = self._points - at[there]
        good = self._believed(away, self._normals, smooth[there], stiffness_mm)
        face, place = np.divmod(np.asarray(there)[good], len(LATTICE))
        for corner in range(3):
            vertices = self._faces[face, corner]
            weight = LATTICE[place, corner] * self._point_areas[good]
            self._pull(springs, vertices, weight, self._normals[good], away[good], moved[vertices])

    def _believed(
        self, away: np.ndarray, one: np.ndarray, other: np.ndarray, stiffness_mm: float
    ) -> np.ndarray:
        """(m,) bool: matches near enough, whose normals (m, 3) agree."""
        near = np.linalg.norm(away, axis=1) < max(stiffness_mm, self._config.least_mm)
        agree = np.einsum("nk,nk->n", one, other) > np.cos(np.deg2rad(self._config.normal_deg))
        return np.asarray(near & agree)

    def _pull(
        self,
        springs: Springs,
        vertices: np.ndarray,
        weight: np.ndarray,
        normal: np.ndarray,
        away: np.ndarray,
        moved: np.ndarray,
    ) -> None:
        """Add (m,) springs of some weight, each onto a plane; vertices may come more than once."""
        hold = self._config.hold
        matrix = (1 - hold) * normal[:, :, None] * normal[:, None, :] + hold * np.eye(3)
        matrix *= weight[:, None, None]
        np.add.at(springs.stiffness, vertices, matrix)
        np.add.at(springs.pull, vertices, np.einsum("kij,kj->ki", matrix, moved + away))


def vertex_areas(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) mm^2 of each vertex: a third of its triangles'."""
    corners = vertices[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    third = np.repeat(np.linalg.norm(cross, axis=1) / 6, 3)
    return np.bincount(triangles.ravel(), third, minlength=len(vertices))
