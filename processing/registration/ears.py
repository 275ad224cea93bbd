"""Where a person's ears are: what is off the skin of a mesh that was fitted without its ears.

Ears have no landmark, and ears of two people differ by more in place and size than a closest point
can bridge. So each is found on the scan as a whole, and the template's is moved onto it by a
similarity before non-rigid ICP begins.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh, connected, directed_edges, vertex_normals
from processing.errors import RegistrationError
from processing.registration.both_ways import vertex_areas
from processing.registration.config import EarConfig, PlateConfig
from processing.registration.plate import Plate, Springs
from processing.registration.rigid import Similarity, umeyama
from processing.registration.target import Target

HELD_MM2 = 1e4
LEAST_VERTICES = 8
"""Least number of vertices of a template's ear; fewer are isolated crumbs of the region."""
BLEND_STIFFNESS_MM = 5.0
"""Stiffness of the plate between an ear that was moved and skin that was not, both held this hard.
"""


def find_ears(
    vertices: np.ndarray, triangles: np.ndarray, ears: np.ndarray, target: Target, config: EarConfig
) -> list[tuple[np.ndarray, Similarity]]:
    """Ears of a scan as wholes.

    Args:
        vertices: (n, 3) mm of a mesh that is on the scan but for its ears.
        triangles: (t, 3).
        ears: (n,) bool.
        target: the scan.
        config: settings.

    Returns:
        Of each ear that the scan shows, its (k,) vertices and their similarity to the scan's.
    """
    out: list[tuple[np.ndarray, Similarity]] = []
    if not (config.sought and ears.any() and (~ears[triangles]).any()):
        return out
    skin = Target(Mesh(_without(vertices, triangles, ears), triangles))
    own = _Ear.all_of(vertices, triangles)
    scan = _Ear(target.vertices, target.normals, vertex_areas(target.vertices, target.triangles))
    used = np.unique(target.triangles)
    for ear in _parts(triangles, ears, 2):
        centre = vertices[ear].mean(axis=0)
        reach = config.reach * np.linalg.norm(vertices[ear] - centre, axis=1).max()
        near = used[np.linalg.norm(target.vertices[used] - centre, axis=1) < reach]
        off = np.zeros(len(target.vertices), bool)
        off[near] = _height(target.vertices[near], skin) > config.stands_off_mm
        # The largest part: a shoulder is no ear.
        for found in _parts(target.triangles, off, 1):
            raised = ear[_height(vertices[ear], skin) > config.stands_off_mm]
            place = scan.some(found[:: max(1, len(found) // config.points)])
            pose = _fitted_ear(own.some(raised), place, config)
            if pose is not None:
                out.append((ear, pose))
    return out


def ears_in_place(
    vertices: np.ndarray,
    triangles: np.ndarray,
    found: list[tuple[np.ndarray, Similarity]],
    plate: PlateConfig,
    blend_mm: float,
) -> np.ndarray:
    """A mesh with its ears moved as wholes, and the skin around them after them as a plate bends.

    Args:
        vertices: (n, 3) mm, the mesh on which the ears were found.
        triangles: (t, 3).
        found: by `find_ears` on it: (k,) vertices and their similarity.
        plate: settings.
        blend_mm: what is farther from all ears stays.

    Returns:
        (n, 3) mm.
    """
    if not found:
        return vertices
    moved, held = np.zeros_like(vertices), np.zeros(len(vertices), bool)
    for ear, pose in found:
        moved[ear] = pose.apply(vertices[ear]) - vertices[ear]
        held[ear] = True
    held |= cKDTree(vertices[held]).query(vertices)[0] > blend_mm
    springs = Springs.none(len(vertices))
    some = np.flatnonzero(held)
    springs.add(some, HELD_MM2 * np.tile(np.eye(3), (len(some), 1, 1)), moved[some])
    sheet = Plate(vertices, triangles, plate)
    sheet.stiffen(BLEND_STIFFNESS_MM, springs)
    return vertices + sheet.solve(springs, moved)


def _parts(triangles: np.ndarray, chosen: np.ndarray, most: int) -> list[np.ndarray]:
    """Vertices of the largest connected parts of (n,) chosen ones; isolated crumbs are no part."""
    if not chosen.any():
        return []
    ends = directed_edges(triangles)
    label = connected(ends[chosen[ends].all(axis=1)], len(chosen))
    size = np.bincount(label[chosen], minlength=label.max() + 1)
    largest = np.argsort(-size, kind="stable")[:most]
    return [np.flatnonzero(chosen & (label == k)) for k in largest if size[k] >= LEAST_VERTICES]


def _without(vertices: np.ndarray, triangles: np.ndarray, ears: np.ndarray) -> np.ndarray:
    """(n, 3) mm, the skin as if there were no ears: a membrane closes their places.

    Each vertex of an ear is in the mean of its neighbours. Left open, the holes' middles would be
    far from all skin, and so would the scan's skin there.
    """
    ends = directed_edges(triangles)
    count = len(vertices)
    # An edge is listed once for each of its triangles: one in the rim of a hole weighs half.
    joined = sp.coo_matrix((np.ones(len(ends)), ends.T), shape=(count, count)).tocsr()
    joined = joined + joined.T
    laplacian = (sp.diags(np.asarray(joined.sum(axis=1)).ravel()) - joined).tocsr()
    part = connected(ends, count)
    inside = np.flatnonzero(ears & np.isin(part, part[~ears]))
    border = np.flatnonzero(~ears)
    here = laplacian[inside]
    flat = vertices.copy()
    flat[inside] = splu(here[:, inside].tocsc()).solve(-(here[:, border] @ vertices[border]))
    return flat


def _height(points: np.ndarray, skin: Target) -> np.ndarray:
    """(k,) mm that points stand above a surface; negative below it."""
    closest = skin.closest(points)
    return np.einsum("nk,nk->n", points - closest.point, closest.normal)


@dataclasses.dataclass(frozen=True)
class _Ear:
    """Points of a surface: (k, 3) mm, (k, 3) unit normals, (k,) mm^2 that each represents.

    Areas weigh, because a scan's ear hole may have more vertices than all else of the ear.
    """

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray

    @classmethod
    def all_of(cls, vertices: np.ndarray, triangles: np.ndarray) -> _Ear:
        """Every vertex of a mesh of (n, 3) vertices and (t, 3) triangles."""
        return cls(vertices, vertex_normals(vertices, triangles), vertex_areas(vertices, triangles))

    def some(self, chosen: np.ndarray) -> _Ear:
        """These alone."""
        return _Ear(self.points[chosen], self.normals[chosen], self.areas[chosen])

    def centre(self) -> np.ndarray:
        """(3,) mm."""
        return np.average(self.points, axis=0, weights=self.areas)

    def size(self) -> float:
        """Root mean squared distance from the centre, mm."""
        squared = ((self.points - self.centre()) ** 2).sum(axis=1)
        return float(np.sqrt(np.average(squared, weights=self.areas)))


def _fitted_ear(ear: _Ear, place: _Ear, config: EarConfig) -> Similarity | None:
    """The similarity that fits an ear to what is off the skin, searched both ways; None if none."""
    if len(place.points) < config.least_points or len(ear.points) < LEAST_VERTICES:
        return None
    if not (ear.areas.sum() > 0 and place.areas.sum() > 0):
        return None
    size = ear.size()
    start = place.size() / size
    if not config.size[0] < start < config.size[1]:
        return None
    pose = Similarity(np.eye(3), place.centre() - start * ear.centre(), start)
    tree = cKDTree(np.concatenate([place.points, config.radian_mm * place.normals], axis=1))
    share = np.concatenate([one.areas / one.areas.sum() for one in (ear, place)])
    for _ in range(config.rounds):
        turned = config.radian_mm * ear.normals @ pose.rotation.T
        here = np.concatenate([pose.apply(ear.points), turned], axis=1)
        there_mm, there = tree.query(here)
        back_mm, back = cKDTree(here).query(tree.data)
        away = np.concatenate([there_mm, back_mm])
        weight = share / (1 + (away / max(float(np.median(away)), 1e-9)) ** 2)
        try:
            pose = umeyama(
                np.concatenate([ear.points, ear.points[back]]),
                np.concatenate([place.points[there], place.points]),
                weight,
                scale=True,
            )
        except RegistrationError:
            return None
    left = float(np.median(np.linalg.norm(place.points[there] - pose.apply(ear.points), axis=1)))
    good = config.size[0] < pose.scale < config.size[1]
    return pose if good and left < config.residual_share * size else None
