"""The detector's points on a mesh's surface: seen from all sides, and where the sight lines meet.

Each view's points are lines of sight. Those that see the place (it faces them and nothing hides it)
meet in a point by least squares whose weights fall with the distance [Holland1977], so that a
view in which the detector slipped counts for little; the mesh's nearest place is taken.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import open3d

from learning.errors import LearningError
from learning.points.pictures import Coloured, Lamp, camera_at, pictures_of
from lightstage.commands import ProgressCallback, quiet
from lightstage.faces import detect_faces
from lightstage.formats.surface_points import COUNTS, SurfacePoints

SCHEME = "mediapipe468"


@dataclasses.dataclass(frozen=True)
class PointsConfig:
    """How a mesh is looked at."""

    yaws_deg: tuple[float, ...] = (-50.0, -35.0, -20.0, -8.0, 8.0, 20.0, 35.0, 50.0)
    pitches_deg: tuple[float, ...] = (-25.0, -8.0, 8.0, 25.0)
    lamps: tuple[Lamp, ...] = (
        Lamp(10.0, 25.0, 0.5),
        Lamp(-55.0, 20.0, 0.35),
        Lamp(55.0, 20.0, 0.35),
    )
    facing: float = 0.25
    """Cosine between normal and line of sight above which a view sees a place."""
    soft_mm: float = 1.5
    """A line of sight this far from a point counts half."""
    rounds: int = 12
    fewest_views: int = 6
    largest_spread_mm: float = 8.0
    """A point whose lines of sight are farther apart (median) has no place on the mesh."""


def find_points(
    head: Coloured, config: PointsConfig | None = None, progress: ProgressCallback = quiet
) -> tuple[SurfacePoints, dict[str, int]]:
    """Find where the 468 points lie on a mesh.

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
            hint="Does the face look along +z with +y up, in mm? Do regions and landmarks lie "
            "where they should?",
        )
    points = _surface_points(head, np.array(origins), np.array(directions), settings)
    return points, {"pictures": made, "faces": len(origins)}


def _surface_points(
    head: Coloured, origins: np.ndarray, directions: np.ndarray, config: PointsConfig
) -> SurfacePoints:
    """Where (v, 468, 3) lines of sight from (v, 3) places meet, on the mesh."""
    count = COUNTS[SCHEME]
    triangles = np.full((count, 3), -1, np.int64)
    weights = np.full((count, 3), np.nan)
    spread = np.full(count, np.nan)
    for index in range(count):
        lines = directions[:, index]
        point = _meeting(origins, lines, config)
        # What sees the place can be told only when it is known about where it is.
        for _ in range(2):
            place = _on_mesh(head, point)
            seen = _sees(head, place[0], place[1], origins, config.facing)
            if seen.sum() < config.fewest_views:
                break
            point = _meeting(origins[seen], lines[seen], config)
        else:
            place = _on_mesh(head, point)
            apart = float(np.median(_away(place[0], origins[seen], lines[seen])))
            if apart <= config.largest_spread_mm:
                triangles[index], weights[index], spread[index] = place[2], place[3], apart
    return SurfacePoints(SCHEME, triangles, weights, spread)


def _away(point: np.ndarray, origins: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """(v,) distances of a point from lines, mm."""
    offset = point - origins
    along = np.einsum("vk,vk->v", offset, lines)
    return np.asarray(np.linalg.norm(offset - along[:, None] * lines, axis=1))


def _meeting(origins: np.ndarray, lines: np.ndarray, config: PointsConfig) -> np.ndarray:
    """(3,) the point that most lines pass near: least squares, reweighted [Holland1977]."""
    across = np.eye(3) - lines[:, :, None] * lines[:, None, :]
    right = np.einsum("vij,vj->vi", across, origins)
    share = np.ones(len(lines))
    point = np.zeros(3)
    for _ in range(config.rounds):
        point = np.linalg.solve(np.einsum("v,vij->ij", share, across), share @ right)
        share = 1 / (1 + (_away(point, origins, lines) / config.soft_mm) ** 2)
    return point


def _on_mesh(
    head: Coloured, point: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mesh's nearest place: (3,) itself, its normal, its triangle's vertices and weights."""
    query = open3d.core.Tensor(np.asarray(point, np.float32)[None])
    found = head.scene.compute_closest_points(query)
    corners = head.triangles[int(found["primitive_ids"].numpy()[0])]
    u, v = (float(w) for w in found["primitive_uvs"].numpy()[0])
    weights = np.clip([1 - u - v, u, v], 0, 1)
    weights /= weights.sum()
    return weights @ head.mesh.vertices[corners], weights @ head.normals[corners], corners, weights


def _sees(
    head: Coloured, place: np.ndarray, normal: np.ndarray, origins: np.ndarray, facing: float
) -> np.ndarray:
    """(v,) bool: which cameras see a place of the mesh."""
    toward = origins - place
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    rays = np.empty((len(origins), 6), np.float32)
    rays[:, :3], rays[:, 3:] = place + 0.5 * normal + 0.5 * toward, toward
    hidden = head.scene.test_occlusions(open3d.core.Tensor(rays)).numpy()
    return np.asarray((toward @ normal > facing) & ~hidden)
