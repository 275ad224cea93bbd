"""The detector's points on a mesh's surface: seen from all sides, and where the sight lines meet.

Each view's points are lines of sight. Those that see the place (it faces them and nothing hides it)
meet in a point by least squares whose weights fall with the distance [Holland1977], so that a
view in which the detector slipped counts for little; the mesh's nearest place is taken.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import open3d

from learning.errors import LearningError
from learning.points.pictures import Coloured, Lamp, camera_at, pictures_of
from lightstage.commands import ProgressCallback, quiet
from lightstage.faces import detect_faces
from lightstage.formats.surface_points import FACE_SCHEME, SurfacePoints

OFF_MM = 0.5
"""Rays begin so far off the mesh, towards the camera and along the normal."""


@dataclasses.dataclass(frozen=True)
class PointsConfig:
    """Settings by which a mesh is drawn."""

    yaws_deg: tuple[float, ...] = (-50.0, -35.0, -20.0, -8.0, 8.0, 20.0, 35.0, 50.0)
    """Directions of the views to the person's left; each is drawn with each of `pitches_deg`."""
    pitches_deg: tuple[float, ...] = (-25.0, -8.0, 8.0, 25.0)
    """Directions of the views upward."""
    lamps: tuple[Lamp, ...] = (
        Lamp(10.0, 25.0, 0.5),
        Lamp(-55.0, 20.0, 0.35),
        Lamp(55.0, 20.0, 0.35),
    )
    """Lamps under each of which every view is drawn."""
    facing: float = 0.25
    """Cosine between normal and line of sight above which a view sees a place."""
    soft_mm: float = 1.5
    """A line of sight this far from a point counts half."""
    rounds: int = 12
    """Rounds of reweighting in which a point's lines of sight are joined."""
    fewest_views: int = 6
    """Least number of views that see a point for it to have a place on the mesh."""
    largest_spread_mm: float = 8.0
    """A point whose lines of sight are farther apart (median) has no place on the mesh."""


def find_points(
    head: Coloured, config: PointsConfig | None = None, progress: ProgressCallback = quiet
) -> tuple[SurfacePoints, dict[str, int]]:
    """Find the places of the 468 points on a mesh.

    Args:
        head: the mesh and its colours, face toward +z, +y up.
        config: settings.
        progress: of views.

    Returns:
        The points, and how many pictures were made and how many showed a face.

    Raises:
        LearningError: a face was seen in fewer than half of the pictures.
    """
    settings = config or PointsConfig()
    places = [(y, p) for y in settings.yaws_deg for p in settings.pitches_deg]
    origins, directions = [], []
    for done, (yaw, pitch) in enumerate(places, 1):
        camera = camera_at(head.middle_mm, yaw, pitch)
        for picture in pictures_of(head, camera, list(settings.lamps)):
            faces = detect_faces(picture)
            if faces:
                x, y = faces[0].points_px.T
                origins.append(camera.centre_mm)
                directions.append(camera.rays_through(x, y))
        progress(done, len(places))
    made = len(places) * len(settings.lamps)
    if 2 * len(origins) < made:
        raise LearningError(
            "template points",
            found=f"a face in {len(origins)} of {made} pictures of the mesh",
            expected="a face in most of them",
            hint="Does the face look along +z with +y up, in mm? Are regions and landmarks "
            "where they should?",
        )
    points = _surface_points(head, np.array(origins), np.array(directions), settings)
    return points, {"pictures": made, "faces": len(origins)}


def _surface_points(
    head: Coloured, origins: np.ndarray, lines: np.ndarray, config: PointsConfig
) -> SurfacePoints:
    """Where (v, n, 3) lines of sight from (v, 3) places meet, on the mesh."""
    seen = np.ones(lines.shape[:2], bool)
    there = np.ones(lines.shape[1], bool)
    near = _on_mesh(head, _meeting(origins, lines, seen, config))
    # Which cameras see a place is known only once its approximate position is.
    for _ in range(2):
        sees = _sees(head, near, origins, config.facing)
        there &= sees.sum(axis=0) >= config.fewest_views
        seen = sees | ~there
        near = _on_mesh(head, _meeting(origins, lines, seen, config))
    away = np.where(seen, _away(near.places, origins, lines), np.nan)
    spread = np.nanmedian(away, axis=0)
    there &= spread <= config.largest_spread_mm
    return SurfacePoints(
        FACE_SCHEME,
        np.where(there[:, None], near.corners, -1),
        np.where(there[:, None], near.weights, np.nan),
        np.where(there, spread, np.nan),
    )


def _away(points: np.ndarray, origins: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """(v, n) distances of (n, 3) points from their lines in each view, mm."""
    offset = points - origins[:, None]
    along = np.einsum("vnk,vnk->vn", offset, lines)
    return np.asarray(np.linalg.norm(offset - along[..., None] * lines, axis=2))


def _meeting(
    origins: np.ndarray, lines: np.ndarray, seen: np.ndarray, config: PointsConfig
) -> np.ndarray:
    """(n, 3) points that most of their lines pass near: reweighted least squares [Holland1977].

    Args:
        origins: (v, 3).
        lines: (v, n, 3) unit.
        seen: (v, n) bool, lines that count; at least two of each point.
        config: settings.
    """
    across = np.eye(3) - lines[..., :, None] * lines[..., None, :]
    right = np.einsum("vnij,vj->vni", across, origins)
    share = seen.astype(float)
    points = np.zeros(lines.shape[1:])
    for _ in range(config.rounds):
        matrix = np.einsum("vn,vnij->nij", share, across)
        side = np.einsum("vn,vni->ni", share, right)
        points = np.linalg.solve(matrix, side[..., None])[..., 0]
        share = seen / (1 + (_away(points, origins, lines) / config.soft_mm) ** 2)
    return points


class _Near(NamedTuple):
    """The mesh's nearest places to n points.

    Attributes:
        places: (n, 3) mm.
        normals: (n, 3).
        corners: (n, 3) vertex indices.
        weights: (n, 3) of the corners.
    """

    places: np.ndarray
    normals: np.ndarray
    corners: np.ndarray
    weights: np.ndarray


def _on_mesh(head: Coloured, points: np.ndarray) -> _Near:
    query = open3d.core.Tensor(np.ascontiguousarray(points, np.float32))
    found = head.scene.compute_closest_points(query)
    corners = head.triangles[found["primitive_ids"].numpy()].astype(np.int64)
    uv = found["primitive_uvs"].numpy().astype(float)
    weights = np.clip(np.column_stack([1 - uv.sum(axis=1), uv]), 0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    at = np.einsum("nc,nck->nk", weights, head.mesh.vertices[corners])
    return _Near(at, np.einsum("nc,nck->nk", weights, head.normals[corners]), corners, weights)


def _sees(head: Coloured, near: _Near, origins: np.ndarray, facing: float) -> np.ndarray:
    """(v, n) bool: which cameras see which places."""
    toward = origins[:, None] - near.places
    toward /= np.linalg.norm(toward, axis=2, keepdims=True)
    start = near.places + OFF_MM * near.normals + OFF_MM * toward
    rays = np.concatenate([start, toward], axis=2).astype(np.float32)
    hidden = head.scene.test_occlusions(open3d.core.Tensor(rays)).numpy()
    return np.asarray((np.einsum("vnk,nk->vn", toward, near.normals) > facing) & ~hidden)
