"""Cameras, lights and true landmarks of the photographs that tests take."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from learning.photo.config import FitConfig
from learning.photo.shape_fit import Places
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera, look_at

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 360, 480, 1000.0
SMALL = FitConfig(identity_modes=20, free_modes=20, pixel_rounds=0)
"""A fit of few unknowns."""
KEY = LightSet(
    "key",
    np.array([[500.0, 400.0, 900.0]]),
    np.full((1, 3), 0.7),
    np.full(3, 0.25),
)


@dataclasses.dataclass(frozen=True)
class Shot:
    """A photograph's file, and what is true of it."""

    path: Path
    camera: Camera
    mesh: Mesh
    landmarks_px: np.ndarray


def camera_at(yaw_deg: float, focal_px: float = FOCAL_PX, distance_mm: float = 800.0) -> Camera:
    """A camera that looks at a face in the head frame from its left by some degrees."""
    turn, aim = np.radians(yaw_deg), np.array([0.0, -20.0, 40.0])
    place = aim + distance_mm * np.array([np.sin(turn), 0.0, np.cos(turn)])
    return Camera(
        "photo",
        "",
        "",
        WIDTH_PX,
        HEIGHT_PX,
        focal_px,
        focal_px,
        WIDTH_PX / 2,
        HEIGHT_PX / 2,
        (0.0,) * 5,
        look_at(place, aim),
    )


def on(places: Places, vertices: np.ndarray) -> np.ndarray:
    """(p, 3) where landmarks lie on vertices."""
    found: np.ndarray = np.einsum("pck,pc->pk", vertices[places.triangles], places.weights)
    return found
