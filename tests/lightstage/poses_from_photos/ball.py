"""Textured balls on a black ground, photographed from known places."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.formats.exr import write_exr
from lightstage.rig import Camera, default_rig

RADIUS_MM = 90.0
ONE = ((0.0, 0.0, 0.0, RADIUS_MM),)
"""x, y, z and radius, mm. One small ball before long lenses tells focal lengths badly."""
DEEP = (
    (0.0, 0.0, 40.0, 70.0),
    (-110.0, 50.0, -60.0, 60.0),
    (110.0, 60.0, -30.0, 60.0),
    (-90.0, -90.0, 60.0, 55.0),
    (90.0, -100.0, 90.0, 50.0),
    (0.0, 130.0, -90.0, 60.0),
)
"""Balls at several depths, which tell them well."""


def cameras(ids: tuple[int, ...] = (0, 1, 2, 5, 6), factor: float = 0.1) -> list[Camera]:
    """Cameras of the default rig with few pixels."""
    rig = default_rig().scaled(factor)
    return [rig.camera(f"cam{k}") for k in ids]


def photograph(
    camera: Camera,
    seed: int = 3,
    noise: float = 0.001,
    balls: tuple[tuple[float, float, float, float], ...] = ONE,
) -> np.ndarray:
    """(h, w, 3) linear light of balls under light from everywhere; blobs of 2 to 30 mm on them."""
    origin, rays = camera.pixel_rays()
    distance = np.full(rays.shape[:2], np.inf)
    for *place, radius in balls:
        from_it = origin - np.array(place)
        along = rays @ from_it
        root = along**2 - (from_it @ from_it - radius**2)
        here = -along - np.sqrt(np.maximum(root, 0))
        distance = np.where((root > 0) & (along < 0), np.minimum(distance, here), distance)
    return _textured(camera, distance, seed, noise)


def wall(camera: Camera, seed: int = 3, noise: float = 0.001) -> np.ndarray:
    """The same of a wall 300 mm wide and high in the plane z = 0."""
    origin, rays = camera.pixel_rays()
    distance = -origin[2] / np.where(rays[..., 2] < 0, rays[..., 2], -np.inf)
    there = origin + rays * distance[..., None]
    inside = (np.abs(there[..., :2]) < 150).all(axis=-1)
    return _textured(camera, np.where(inside, distance, np.inf), seed, noise)


def _textured(camera: Camera, distance: np.ndarray, seed: int, noise: float) -> np.ndarray:
    origin, rays = camera.pixel_rays()
    hit = np.isfinite(distance)
    points = origin + rays * np.where(hit, distance, 0)[..., None]
    rng = np.random.default_rng(seed)
    value = np.full(points.shape[:2], 0.5)
    for _ in range(60):
        length = np.exp(rng.uniform(np.log(5.0), np.log(40.0)))
        direction = rng.normal(size=3)
        wave = 2 * np.pi / length * direction / np.linalg.norm(direction)
        value += 0.03 * np.sin(points @ wave + rng.uniform(0, 2 * np.pi))
    light = np.where(hit, np.clip(value, 0.02, 1), 0)[..., None] * np.array([1.0, 0.8, 0.6])
    camera_number = int(camera.id.removeprefix("cam"))
    light += np.random.default_rng([seed, camera_number]).normal(0, noise, light.shape)
    return light.astype(np.float32)


def put(folder: Path, cams: list[Camera], patterns: tuple[str, ...] = ("full",)) -> dict[str, Path]:
    """Write PATTERN/CAMERA.exr; the first pattern's photographs by camera."""
    for pattern in patterns:
        for camera in cams:
            write_exr(folder / pattern / f"{camera.id}.exr", photograph(camera))
    return {camera.id: folder / patterns[0] / f"{camera.id}.exr" for camera in cams}
