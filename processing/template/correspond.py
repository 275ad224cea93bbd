"""Which place of one mesh each point of another is, where both are on the same face."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.closest import ClosestPoints
from processing.registration.rigid import umeyama
from processing.template.config import TransferConfig

AXES = np.concatenate([np.eye(3), -np.eye(3)])
FACING = 0.25
"""Least cosine of a triangle's normal to an axis for it to be searched along that axis."""


@dataclasses.dataclass(frozen=True)
class Places:
    """Places on a mesh, one a query.

    Attributes:
        face: (n,) int64 triangle; 0 where there is none.
        weights: (n, 3) of its corners.
        distance_mm: (n,).
        there: (n,) bool, whether the mesh has this place.
    """

    face: np.ndarray
    weights: np.ndarray
    distance_mm: np.ndarray
    there: np.ndarray

    def of(self, values: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """(n, c) of values (v, c) at the triangles' corners."""
        return np.einsum("nk,nkc->nc", self.weights, values[triangles[self.face]])


class Surface:
    """A mesh prepared for the question which of its places a point with a normal is."""

    def __init__(self, mesh: Mesh, config: TransferConfig) -> None:
        """Build the hierarchies: of all triangles, and of those that face along each axis."""
        self._config = config
        self._triangles = mesh.triangles()
        self._normals = vertex_normals(mesh.vertices, self._triangles)
        corners = mesh.vertices[self._triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(cross, axis=1)
        unit = np.divide(
            cross, length[:, None], out=np.zeros_like(cross), where=length[:, None] > 0
        )
        self._all = ClosestPoints(mesh.vertices, self._triangles)
        self._facing = []
        for axis in AXES:
            some = np.flatnonzero(unit @ axis > FACING)
            found = ClosestPoints(mesh.vertices, self._triangles[some]) if len(some) else None
            self._facing.append((some, found))

    def places(self, points: np.ndarray, normals: np.ndarray) -> Places:
        """The closest places whose normals agree.

        Lips and lids touch, so that the closest place may be on the other one: where the normals
        disagree, only triangles are searched that face along the axis nearest to the normal.

        Args:
            points: (n, 3) mm, finite.
            normals: (n, 3) unit.
        """
        found = self._all.query(points)
        face = found.face.astype(np.int64)
        weights, away = found.barycentric.astype(float), found.distance_mm.astype(float)
        least = np.cos(np.deg2rad(self._config.angle_deg))
        wrong = np.flatnonzero(~(self._agreement(face, weights, normals) >= least))
        along = np.argmax(normals[wrong] @ AXES.T, axis=1)
        for number, (some, scene) in enumerate(self._facing):
            queried = wrong[along == number]
            if scene is None or not len(queried):
                continue
            again = scene.query(points[queried])
            face[queried] = some[again.face]
            weights[queried], away[queried] = again.barycentric, again.distance_mm
        there = self._agreement(face, weights, normals) >= least
        there &= away <= self._config.farthest_mm
        return Places(face, weights, away, there)

    def _agreement(self, face: np.ndarray, weights: np.ndarray, normals: np.ndarray) -> np.ndarray:
        own = np.einsum("nk,nkc->nc", weights, self._normals[self._triangles[face]])
        length = np.maximum(np.linalg.norm(own, axis=1), 1e-12)
        return np.asarray(np.einsum("nc,nc->n", own, normals) / length)


def carried_vertices(
    placed: Mesh, person: np.ndarray, other: Mesh, config: TransferConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Where another template's vertices are on a person.

    Args:
        placed: the first template, fitted to the other one.
        person: (n, 3) mm, the first template's vertices on the person.
        other: the other template's mesh.
        config: settings.

    Returns:
        (m, 3) mm; and (m,) bool, vertices whose place the first template has. The others, such as
        eyeballs, go as those around them do.
    """
    triangles = other.triangles()
    normals = vertex_normals(other.vertices, triangles)
    places = Surface(placed, config).places(other.vertices, normals)
    known = places.there
    if not known.any():
        return other.vertices.copy(), known
    out = places.of(person, placed.triangles())
    pose = umeyama(other.vertices[known], out[known], scale=True)
    moved = out - pose.apply(other.vertices)
    count = min(config.neighbours, int(known.sum()))
    away, near = cKDTree(other.vertices[known]).query(other.vertices[~known], k=count)
    away, near = (np.asarray(each).reshape(-1, count) for each in (away, near))
    weight = 1 / (away + 1.0) ** 2
    shift = np.einsum("nk,nkc->nc", weight, moved[known][near]) / weight.sum(axis=1)[:, None]
    out[~known] = pose.apply(other.vertices[~known]) + shift
    return out, known
