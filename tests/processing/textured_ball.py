"""A ball with a procedural texture, seen by known cameras under a few lights: exact depths."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.rig import Camera, default_rig
from processing.reconstruction.views import View, common_basis, make_view

RADIUS_MM = 90.0
LIGHTS = np.array([[0, 0, 1.0], [0.8, 0, 0.6], [-0.8, 0, 0.6], [0, 0.8, 0.6], [0, -0.8, 0.6]])


def cameras(count: int = 5, factor: float = 0.045) -> list[Camera]:
    """The frontal camera of the default rig and its neighbours, with few pixels."""
    rig = default_rig().scaled(factor)
    return [rig.camera(f"cam{k}") for k in (0, 1, 2, 5, 6, 7, 8, 3, 4)[:count]]


def albedo(points_mm: np.ndarray, seed: int = 3) -> np.ndarray:
    """(..., 3) colour at world points: a sum of waves of 4 to 40 mm in random directions."""
    rng = np.random.default_rng(seed)
    out = np.full((*points_mm.shape[:-1], 3), [0.5, 0.35, 0.25])
    for _ in range(40):
        length = np.exp(rng.uniform(np.log(4.0), np.log(40.0)))
        direction = rng.normal(size=3)
        wave = 2 * np.pi / length * direction / np.linalg.norm(direction)
        shift, tint = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.0, 3)
        out += 0.015 * np.sin(points_mm @ wave + shift)[..., None] * tint
    return np.clip(out, 0.02, 1)


def shoot(
    camera: Camera,
    rng: np.random.Generator,
    noise: float = 0.001,
    balls: tuple[tuple[float, float], ...] = ((RADIUS_MM, 0.0),),
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Photograph the ball, or several: radius and how far in front of the origin, mm.

    Returns:
        (P, h, w, 3) linear pictures, (h, w) bool mask, (h, w, 3) normals, (h, w, 3) points in mm.
    """
    origin, rays = camera.pixel_rays()
    nearest = np.full(rays.shape[:2], np.inf)
    points, normals = np.zeros(rays.shape), np.zeros(rays.shape)
    for radius, front in balls:
        centre = np.array([0, 0, front])
        along = rays @ (origin - centre)
        root = along**2 - ((origin - centre) @ (origin - centre) - radius**2)
        distance = np.where((root > 0) & (along < 0), -along - np.sqrt(np.maximum(root, 0)), np.inf)
        hit = distance < nearest
        nearest[hit] = distance[hit]
        points[hit] = origin + rays[hit] * distance[hit][:, None]
        normals[hit] = (points[hit] - centre) / radius
    mask = np.isfinite(nearest)
    shading = np.clip(normals @ LIGHTS.T, 0, None) * mask[..., None]
    images = shading.transpose(2, 0, 1)[..., None] * albedo(points)
    images += rng.normal(0, noise, images.shape)
    return images.astype(np.float32), mask, normals.astype(np.float32), points


def views_of(
    cams: list[Camera],
    rng: np.random.Generator,
    black: tuple[str, ...] = (),
    balls: tuple[tuple[float, float], ...] = ((RADIUS_MM, 0.0),),
) -> tuple[list[View], list[np.ndarray]]:
    """Views of all cameras (those in `black` saw nothing), and the true points."""
    shots = [shoot(camera, rng, balls=balls) for camera in cams]
    shots = [
        (np.zeros_like(s[0]), np.zeros_like(s[1]), np.zeros_like(s[2]), s[3])
        if camera.id in black
        else s
        for camera, s in zip(cams, shots, strict=True)
    ]
    basis = common_basis([s[0] for s in shots], [s[1] for s in shots])
    views = [
        make_view(camera, s[0], np.ones(s[1].shape, bool), s[1], s[2], basis)
        for camera, s in zip(cams, shots, strict=True)
    ]
    return views, [s[3] for s in shots]


def turned_away(camera: Camera) -> Camera:
    """The same camera looking the other way."""
    half_turn = np.diag([-1.0, 1.0, -1.0])
    return dataclasses.replace(camera, cam_from_world=half_turn @ camera.cam_from_world)
