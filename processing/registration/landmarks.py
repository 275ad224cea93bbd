"""Landmarks clicked in pictures, triangulated into the world; wrong clicks are found and named."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from lightstage.nearest_point import nearest_equations
from lightstage.rig import Camera
from processing.rays import MeshRays

UNDISTORT_ROUNDS = 20


@dataclasses.dataclass(frozen=True)
class Outlier:
    """A click that the other views contradict."""

    camera: str
    landmark_idx: int
    error_mm: float
    """Distance of the click's ray from the point that the other views agree on."""

    def __str__(self) -> str:
        return f"{self.camera} landmark {self.landmark_idx} ({self.error_mm:.1f} mm)"


@dataclasses.dataclass(frozen=True)
class Triangulated:
    """Landmarks in the world.

    Attributes:
        points_mm: (n, 3), NaN where fewer than two views agree and no surface was given.
        views: (n,) how many views carry each point.
        residual_mm: (n,) RMS distance of those views' rays from it, NaN where there is none.
        outliers: clicks that were left out.
    """

    points_mm: np.ndarray
    views: np.ndarray
    residual_mm: np.ndarray
    outliers: tuple[Outlier, ...]


def nearest_point(origins: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
    """The point with the least sum of squared distances to rays.

    Args:
        origins: (m, 3).
        directions: (m, 3) unit.

    Returns:
        (3,), or None where the rays are parallel to within about half a degree.
    """
    matrix, right = nearest_equations(origins, directions)
    if np.linalg.eigvalsh(matrix)[0] < 5e-5 * len(directions):
        return None
    return np.asarray(np.linalg.solve(matrix, right))


def triangulate(
    points_px: dict[str, np.ndarray],
    cameras: dict[str, Camera],
    *,
    agree_mm: float,
    surface: MeshRays | None = None,
) -> Triangulated:
    """Triangulate landmarks from several views, leaving out clicks that disagree.

    Every pair of views proposes a point; the one that most rays pass within `agree_mm` (on a tie
    the one with the least summed distance) is refined by least squares over those rays. Two rays
    that miss each other, with no third view to decide, give no point and two outliers. A landmark
    that a single view shows is taken where its ray meets the surface.

    Args:
        points_px: camera id to (n, 2) pixels, NaN where hidden.
        cameras: camera id to camera.
        agree_mm: how far a ray may pass from a landmark.
        surface: the scan, for landmarks of a single view.

    Returns:
        Triangulated.
    """
    names = [name for name in points_px if name in cameras]
    count = len(next(iter(points_px.values()))) if points_px else 0
    points = np.full((count, 3), np.nan)
    residual = np.full(count, np.nan)
    views = np.zeros(count, int)
    outliers: list[Outlier] = []
    origin = np.array([cameras[name].centre_mm for name in names]).reshape(-1, 3)
    rays = [
        cameras[name].rays_through(points_px[name][:, 0], points_px[name][:, 1], UNDISTORT_ROUNDS)
        for name in names
    ]
    direction = np.array(rays).reshape(len(names), count, 3)
    for index in range(count):
        seen = np.flatnonzero(np.isfinite(direction[:, index]).all(axis=1))
        if len(seen) == 1 and surface is not None:
            ray = direction[seen, index]
            hit = surface.cast(origin[seen], ray)
            if hit.face[0] >= 0:
                points[index] = origin[seen[0]] + hit.distance_mm[0] * ray[0]
                residual[index], views[index] = 0.0, 1
            continue
        point, distance = _agreed(origin[seen], direction[seen, index], agree_mm)
        inlier = distance <= agree_mm
        outliers += [
            Outlier(names[view], index, float(error))
            for view, error in zip(seen[~inlier], distance[~inlier], strict=True)
        ]
        if point is not None:
            points[index], views[index] = point, inlier.sum()
            residual[index] = np.sqrt(np.mean(distance[inlier] ** 2))
    return Triangulated(points, views, residual, tuple(outliers))


def _agreed(
    origins: np.ndarray, directions: np.ndarray, agree_mm: float
) -> tuple[np.ndarray | None, np.ndarray]:
    """The point most rays agree on (None without one) and each ray's distance from it."""
    best: np.ndarray | None = None
    best_score = (1, -np.inf)
    closest = np.inf
    for pair in itertools.combinations(range(len(origins)), 2):
        point = nearest_point(origins[list(pair)], directions[list(pair)])
        if point is None:
            continue
        distance = _distances(point, origins, directions)
        closest = min(closest, float(distance[list(pair)].max()))
        inlier = distance <= agree_mm
        score = (int(inlier.sum()), -float(np.minimum(distance, agree_mm).sum()))
        if inlier[list(pair)].all() and score > best_score:
            best, best_score = point, score
    if best is None:
        return None, np.full(len(origins), closest if len(origins) > 1 else 0.0)
    for _ in range(3):
        inlier = _distances(best, origins, directions) <= agree_mm
        refined = nearest_point(origins[inlier], directions[inlier])
        if refined is None:
            break
        best = refined
    return best, _distances(best, origins, directions)


def _distances(point: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    away = point - origins
    along = np.einsum("mi,mi->m", away, directions)
    distance: np.ndarray = np.linalg.norm(away - along[:, None] * directions, axis=1)
    return np.where(along > 0, distance, np.inf)
