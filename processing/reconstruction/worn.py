"""What is worn, and became part of the skin's mesh because it has a colour: red or black cloth.

Photometric normals follow from colour, so coloured cloth is matched with the skin. Its shadows
are then right, yet the gloss of skin would be fitted to it. Its pieces are found by their colour:
they are far from the face's hue, or far darker than the face and of another hue. A shadow makes
skin dark and leaves its hue.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.rig import Camera
from processing.rays import MeshRays
from processing.reconstruction.fusion import compact
from processing.reconstruction.pieces import larger_pieces

OTHER_HUE_DEG = 30.0
"""Colours this far from the face's hue are not skin: lips and hair are within 25."""
DARK, DARK_HUE_DEG = 0.15, 7.0
"""Colours darker than this share of the face, and this far from its hue, are not skin."""
HEAD_SHARE = 0.25
"""Share of the mesh, nearest to where the cameras aim, whose median colour is the face's."""
LEAST_CM2 = 30.0
"""Smaller pieces stay: painted lips, brows, a beard's shadow."""
SAMPLES = 20_000
"""Vertices whose colour is read; the others have that of the nearest of these."""
AMONG = 16
"""Most of so many neighbours decide: single ones are noise or an edge."""
FACE_MM = 60.0
"""Pixels so near to where the cameras aim show the face."""
PIXELS = 10_000
"""Number of pixels of a view that are sampled to decide whether clothes can be present."""
LEAST_SHARE = 0.005
"""Share of these below which nothing is worn, and no ray is cast."""


class Coloured(NamedTuple):
    """A camera and what it shows.

    Attributes:
        camera: of the rig, with its lens.
        colour: (h, w, 3) albedo, 0 where unknown.
    """

    camera: Camera
    colour: np.ndarray


def without_worn(
    mesh: Mesh, occluders: Mesh | None, views: Sequence[Coloured], focus_mm: np.ndarray
) -> tuple[Mesh, Mesh | None]:
    """The skin's mesh without what is worn, and the occluders with it.

    What is above the middle of the mesh stays: hair is no skin either, but a head needs its skull.

    Args:
        mesh: of the skin, mm, world.
        occluders: what else was found; None for nothing.
        views: coarse colours.
        focus_mm: (3,) where the cameras aim.

    Returns:
        Both meshes; the same objects where nothing is worn.
    """
    if not may_wear(views, focus_mm):
        return mesh, occluders
    worn = worn_vertices(mesh, views, focus_mm)
    chosen = larger_pieces(mesh, worn[mesh.faces].all(axis=1), LEAST_CM2)
    if not chosen.any() or chosen.all():
        return mesh, occluders
    cloth = compact(mesh.vertices, mesh.faces[chosen])
    return compact(mesh.vertices, mesh.faces[~chosen]), joined(occluders, cloth)


def may_wear(views: Sequence[Coloured], focus_mm: np.ndarray) -> bool:
    """Whether enough of what views show below the face is no skin by its colour.

    True where no view shows the face: it is not known then.
    """
    near, below = [], []
    down_mm = focus_mm - (0, FACE_MM, 0)
    for camera, colour in views:
        step = max(1, int(np.sqrt(colour[..., 0].size / PIXELS)))
        some = colour[::step, ::step].astype(float)
        (middle, lower), depth = camera.project(np.stack([focus_mm, down_mm]))
        if not (depth > 0).all():
            continue
        known = (some > 0).any(axis=2)
        rows, columns = np.nonzero(known)
        off = step * np.column_stack([columns, rows]) - middle
        down = lower - middle
        near.append(some[known][(off**2).sum(axis=1) < down @ down])
        below.append(some[known][off @ down > 0])
    face = np.concatenate(near) if near else np.zeros((0, 3))
    if not len(face):
        return True
    other = no_skin(np.concatenate(below), np.median(face, axis=0))
    return int(other.sum()) > LEAST_SHARE * len(other)


def worn_vertices(mesh: Mesh, views: Sequence[Coloured], focus_mm: np.ndarray) -> np.ndarray:
    """(v,) bool: vertices of a mesh that are no skin by their colour, and no hair on the skull."""
    step = max(1, len(mesh.vertices) // SAMPLES)
    normals = vertex_normals(mesh.vertices, mesh.faces)[::step]
    points = mesh.vertices[::step]
    colour, known = seen_colours(mesh, points, normals, views)
    points, colour = points[known], colour[known]
    if len(points) <= AMONG:
        return np.zeros(len(mesh.vertices), bool)
    away = np.linalg.norm(points - focus_mm, axis=1)
    face = np.median(colour[away <= np.quantile(away, HEAD_SHARE)], axis=0)
    other = no_skin(colour, face) & (points[:, 1] < np.median(points[:, 1]))
    tree = cKDTree(points)
    agreed = other[tree.query(points, k=AMONG)[1]].mean(axis=1) > 0.5
    return np.asarray(agreed[tree.query(mesh.vertices)[1]])


def no_skin(colour: np.ndarray, face: np.ndarray) -> np.ndarray:
    """(n,) bool: colours (n, 3) that are no skin of a face whose colour is (3,)."""
    length = np.linalg.norm(colour, axis=1)
    across = np.linalg.norm(np.cross(colour, face), axis=1)
    turned = np.degrees(np.arctan2(across, colour @ face))
    dark = length < DARK * np.linalg.norm(face)
    return np.asarray((turned > OTHER_HUE_DEG) | (dark & (turned > DARK_HUE_DEG)))


def seen_colours(
    mesh: Mesh, points: np.ndarray, normals: np.ndarray, views: Sequence[Coloured]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean colours of points on a mesh over the cameras that see them.

    Args:
        mesh: mm, world.
        points: (n, 3) on it.
        normals: (n, 3) of it, unit.
        views: what each camera shows.

    Returns:
        (n, 3) colours, and (n,) bool whether any camera shows one.
    """
    centres = np.array([view.camera.centre_mm for view in views])
    seen = MeshRays(mesh.vertices, mesh.faces).visible(points, normals, centres)
    total, count = np.zeros((len(points), 3)), np.zeros(len(points))
    for index, view in enumerate(views):
        places, depth = view.camera.project(points)
        x, y = (np.floor(np.where(np.isfinite(p), p, -1)).astype(int) for p in places.T)
        height, width = view.colour.shape[:2]
        good = seen[:, index] & (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        found = np.zeros_like(total)
        found[good] = view.colour[y[good], x[good]]
        good &= (found > 0).any(axis=1)
        total[good] += found[good]
        count += good
    return total / np.maximum(count, 1)[:, None], count > 0


def joined(first: Mesh | None, second: Mesh) -> Mesh:
    """Two meshes as one."""
    if first is None:
        return second
    return Mesh(
        np.concatenate([first.vertices, second.vertices]),
        np.concatenate([first.triangles(), second.triangles() + len(first.vertices)]).astype(
            np.int32
        ),
    )
