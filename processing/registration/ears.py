"""Where a person's ears are: what stands off the skin of a mesh that was laid on without its ears.

Ears have no landmark, and ears of two people differ by more in place and size than a closest point
can bridge. So each is found on the scan as a whole, and the template's is moved onto it by a
similarity before non-rigid ICP begins.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh, connected, directed_edges, vertex_normals
from processing.errors import RegistrationError
from processing.registration.plate import Plate, PlateConfig, Springs
from processing.registration.rigid import Similarity, umeyama
from processing.registration.target import Target

HELD_MM2 = 1e4
BLEND_STIFFNESS_MM = 5.0
"""Of the plate between an ear that was moved and skin that was not, both held this hard."""


@dataclasses.dataclass(frozen=True)
class EarConfig:
    """How ears are found and believed."""

    sought: bool = True
    """Whether ears are looked for at all."""
    stands_off_mm: float = 4.0
    """What is farther from the skin without ears is an ear's."""
    reach: float = 1.5
    """It is sought within so many times the ear's size around its centre."""
    least_points: int = 50
    radian_mm: float = 15.0
    """In the search for closest points a turn of the normal by a radian counts like so many mm."""
    rounds: int = 30
    points: int = 2000
    """Of the scan's ear that are used; more add time and no information."""
    size: tuple[float, float] = (0.6, 1.5)
    """An ear outside these sizes against the template's is no ear ..."""
    residual_share: float = 0.25
    """... nor one that fits worse than this share of its size (median)."""
    blend_mm: float = 35.0
    """Skin within this of an ear that is moved to its place makes room for it."""


def find_ears(
    vertices: np.ndarray, triangles: np.ndarray, ears: np.ndarray, target: Target, config: EarConfig
) -> list[tuple[np.ndarray, Similarity]]:
    """Ears of a scan as wholes.

    Args:
        vertices: (n, 3) mm of a mesh that lies on the scan but for its ears.
        triangles: (t, 3).
        ears: (n,) bool.
        target: the scan.
        config: settings.

    Returns:
        Of each ear that the scan shows, its (k,) vertices and what lays them onto the scan's.
    """
    out: list[tuple[np.ndarray, Similarity]] = []
    bare = triangles[~ears[triangles].any(axis=1)]
    if not (config.sought and len(bare) and ears.any()):
        return out
    skin = Target(Mesh(vertices, bare))
    normals = vertex_normals(vertices, triangles)
    for ear in _parts(triangles, ears):
        found = _standing_off(vertices[ear], skin, target, config)
        pose = _laid(vertices[ear], normals[ear], target, found, config)
        if pose is not None:
            out.append((ear, pose))
    return out


def ears_in_place(
    rest: np.ndarray,
    triangles: np.ndarray,
    rough: np.ndarray,
    found: list[tuple[np.ndarray, Similarity]],
    plate: PlateConfig,
    blend_mm: float,
) -> np.ndarray:
    """A mesh with its ears moved as wholes, and the skin around them after them as a plate bends.

    Args:
        rest: (n, 3) mm.
        triangles: (t, 3).
        rough: (n, 3) mm, the mesh on which the ears were found.
        found: by `find_ears` on it.
        plate: settings.
        blend_mm: what is farther from all ears stays.

    Returns:
        (n, 3) mm.
    """
    if not found:
        return rest
    moved, held = np.zeros_like(rest), np.zeros(len(rest), bool)
    for ear, pose in found:
        moved[ear] = pose.apply(rough[ear]) - rough[ear]
        held[ear] = True
    held |= cKDTree(rest[held]).query(rest)[0] > blend_mm
    springs = Springs.none(len(rest))
    some = np.flatnonzero(held)
    springs.add(some, HELD_MM2 * np.tile(np.eye(3), (len(some), 1, 1)), moved[some])
    sheet = Plate(rest, triangles, plate)
    sheet.stiffen(BLEND_STIFFNESS_MM, springs)
    return rest + sheet.solve(springs, moved)


def _parts(triangles: np.ndarray, ears: np.ndarray) -> list[np.ndarray]:
    """Vertices of the region's two largest connected parts; isolated crumbs are no ear."""
    ends = directed_edges(triangles)
    label = connected(ends[ears[ends].all(axis=1)], len(ears))
    size = np.bincount(label[ears], minlength=label.max() + 1)
    largest = np.argsort(-size, kind="stable")[:2]
    return [np.flatnonzero(ears & (label == k)) for k in largest if size[k] >= 8]


def _standing_off(ear: np.ndarray, skin: Target, target: Target, config: EarConfig) -> np.ndarray:
    """Indices of the scan's vertices around an ear that are off the skin."""
    centre = ear.mean(axis=0)
    reach = config.reach * np.linalg.norm(ear - centre, axis=1).max()
    used = np.unique(target.triangles)
    near = used[np.linalg.norm(target.vertices[used] - centre, axis=1) < reach]
    if not len(near):
        return near
    off = near[skin.closest(target.vertices[near]).distance_mm > config.stands_off_mm]
    return off[:: max(1, len(off) // config.points)]


def _laid(
    ear: np.ndarray, normals: np.ndarray, target: Target, found: np.ndarray, config: EarConfig
) -> Similarity | None:
    """The similarity that lays an ear onto what stands off, looked for both ways; None if none."""
    if len(found) < config.least_points:
        return None
    place, facing = target.vertices[found], config.radian_mm * target.normals[found]
    size = _size(ear)
    start = _size(place) / size
    if not config.size[0] < start < config.size[1]:
        return None
    pose = Similarity(np.eye(3), place.mean(axis=0) - start * ear.mean(axis=0), start)
    tree = cKDTree(np.concatenate([place, facing], axis=1))
    for _ in range(config.rounds):
        turned = config.radian_mm * normals @ pose.rotation.T
        here = np.concatenate([pose.apply(ear), turned], axis=1)
        there_mm, there = tree.query(here)
        back_mm, back = cKDTree(here).query(tree.data)
        away = np.concatenate([there_mm, back_mm])
        weight = 1 / (1 + (away / max(float(np.median(away)), 1e-9)) ** 2)
        weight /= np.concatenate([np.full(len(ear), len(ear)), np.full(len(place), len(place))])
        try:
            pose = umeyama(
                np.concatenate([ear, ear[back]]),
                np.concatenate([place[there], place]),
                weight,
                scale=True,
            )
        except RegistrationError:
            return None
    left = float(np.median(np.linalg.norm(place[there] - pose.apply(ear), axis=1)))
    good = config.size[0] < pose.scale < config.size[1]
    return pose if good and left < config.residual_share * size else None


def _size(points: np.ndarray) -> float:
    """Root mean squared distance from the centre, mm."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
