"""Subjects of simple shape: a plane and a corner, facing +z."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera, Light, Rig, look_at
from sim.people.subject import Subject


def grid_mesh(places: np.ndarray) -> Mesh:
    """A mesh of quads through (rows, columns, 3) places, its UV the whole tile."""
    rows, columns = places.shape[:2]
    v, u = np.meshgrid(np.linspace(1, 0, rows), np.linspace(0, 1, columns), indexing="ij")
    corner = np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)
    faces = np.stack([corner, corner + columns, corner + columns + 1, corner + 1], axis=-1)
    faces = faces.reshape(-1, 4).astype(np.int32)
    return Mesh(places.reshape(-1, 3), faces, np.stack([u.ravel(), v.ravel()], axis=1), faces)


def subject_of(
    mesh: Mesh,
    albedo: float = 0.5,
    roughness: float = 0.3,
    specular: float = 1 / 36,
    **more: object,
) -> Subject:
    """Skin alike everywhere; the texture holds no normals, so the mesh's own shade."""
    shape = (32, 32)
    values = {
        "name": "shape",
        "expression": "neutral",
        "mesh": mesh,
        "diffuse_albedo": np.full((*shape, 3), albedo, np.float32),
        "specular_albedo": np.full(shape, specular, np.float32),
        "roughness": np.full(shape, roughness, np.float32),
        "normal": np.zeros((*shape, 3), np.float32),
        "translucency": np.ones(shape, np.float32),
        "landmarks_mm": np.zeros((68, 3)),
        "skin": np.ones(shape, bool),
        "head_from_world": np.eye(4)[:3],
        "source": "analytic",
    }
    return Subject(**{**values, **more})


def plane(size_mm: float = 40.0, **more: object) -> Subject:
    """A square in z = 0."""
    y, x = np.meshgrid(np.linspace(0.5, -0.5, 3), np.linspace(-0.5, 0.5, 3), indexing="ij")
    return subject_of(grid_mesh(size_mm * np.stack([x, y, 0 * x], axis=-1)), **more)


def corner(size_mm: float = 60.0, **more: object) -> Subject:
    """Two walls that meet at a right angle along y, open toward +z: much light goes between."""
    along = np.array([[-1.0, 1.0], [0.0, 0.0], [1.0, 1.0]])
    y = np.linspace(1, -1, 5)
    places = np.zeros((len(y), 3, 3))
    places[..., 0], places[..., 2] = along[:, 0], along[:, 1] - 0.5
    places[..., 1] = y[:, None]
    return subject_of(grid_mesh(size_mm * places / 2), **more)


def stage(lights_mm: np.ndarray, width: int = 16, height: int = 16, field_mm: float = 60.0) -> Rig:
    """Lamps, and one camera at (0, 0, 1000) whose picture spans `field_mm` at the origin."""
    place = np.array([0.0, 0.0, 1000.0])
    camera = Camera(
        id="cam0",
        serial="1",
        model="any",
        width_px=width,
        height_px=height,
        fx_px=width * 1000 / field_mm,
        fy_px=width * 1000 / field_mm,
        cx_px=width / 2,
        cy_px=height / 2,
        dist=(0.0, 0.0, 0.0, 0.0, 0.0),
        cam_from_world=look_at(place, np.zeros(3)),
    )
    lights = tuple(
        Light(k, f"light{k}", (float(p[0]), float(p[1]), float(p[2])), "horizontal")
        for k, p in enumerate(lights_mm)
    )
    return Rig(lights, (camera,))
