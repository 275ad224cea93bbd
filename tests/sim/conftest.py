"""A ball with known shape and skin, and a tiny rig."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera, Light, Rig, look_at
from sim.light.scene import Scene
from sim.light.world import World
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.truth import vertex_occlusion, write_truth


@functools.cache
def one_person() -> Subject:
    """A parametric person of 384 rows, made once; not to be changed."""
    return load_subject("parametric", 3, None, 384)


@functools.cache
def _open_sky_of_one_person() -> np.ndarray:
    return vertex_occlusion(Scene(one_person()))


def write_truth_of_one_person(world: World, out: Path) -> Path:
    """`write_truth`; how much sky the person's vertices see is found once for all rigs."""
    assert world.subject is one_person()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sim.truth.vertex_occlusion", lambda _: _open_sky_of_one_person())
        return write_truth(world, out)


def ball_mesh(radius_mm: float = 80.0, rows: int = 48, columns: int = 96) -> Mesh:
    """A sphere of quads: u runs around +y, v from the south pole to the north pole."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    polar, azimuth = np.pi * (1 - v), 2 * np.pi * (u - 0.5)
    normal = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], axis=-1
    )
    corner = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)
    faces = np.stack([corner, corner + 1, corner + columns + 2, corner + columns + 1], axis=-1)
    faces = faces.reshape(-1, 4).astype(np.int32)
    uvs = np.stack([u.ravel(), v.ravel()], axis=1)
    return Mesh(radius_mm * normal.reshape(-1, 3), faces, uvs, faces)


def ball_subject(radius_mm: float = 80.0, texture_rows: int = 96) -> Subject:
    """The ball as a person: skin colour varies with u, landmarks lie on its front."""
    rows, columns = texture_rows, texture_rows
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, 1 - (np.arange(rows) + 0.5) / rows)
    polar, azimuth = np.pi * (1 - v), 2 * np.pi * (u - 0.5)
    normal = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], axis=-1
    )
    albedo = np.stack([0.5 + 0.2 * np.sin(9 * azimuth), 0.4 + 0 * u, 0.3 + 0 * u], axis=-1)
    spread = np.linspace(-0.6, 0.6, 68)
    marks = np.stack([np.sin(spread), 0.3 * np.cos(9 * spread), np.cos(spread)], axis=1)
    return Subject(
        name="ball",
        expression="neutral",
        mesh=ball_mesh(radius_mm),
        diffuse_albedo=albedo.astype(np.float32),
        specular_albedo=np.full((rows, columns), 0.028, np.float32),
        roughness=np.full((rows, columns), 0.3, np.float32),
        normal=normal.astype(np.float32),
        translucency=np.zeros((rows, columns), np.float32),
        landmarks_mm=radius_mm * marks / np.linalg.norm(marks, axis=1, keepdims=True),
        skin=np.abs(azimuth) < 1.2,
        head_from_world=np.eye(4)[:3],
        source="analytic",
    )


def small_rig(lights: int = 20, width: int = 64, height: int = 96, cameras: int = 2) -> Rig:
    """Lights spread evenly over a sphere of 1250 mm, cameras at 1100 mm."""
    index = np.arange(lights) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / lights), index * np.pi * (3 - np.sqrt(5))
    place = 1250 * np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    made = []
    for k in range(cameras):
        angle = 0.4 * k
        centre = np.array([1100 * np.sin(angle), 0, 1100 * np.cos(angle)])
        made.append(
            Camera(
                id=f"cam{k}",
                serial=str(k),
                model="Nikon DSC D750",
                width_px=width,
                height_px=height,
                fx_px=4.4 * width,
                fy_px=4.4 * width,
                cx_px=width / 2,
                cy_px=height / 2,
                dist=(0.0, 0.0, 0.0, 0.0, 0.0),
                cam_from_world=look_at(centre, np.zeros(3)),
            )
        )
    lamps = tuple(
        Light(k, f"light{k}", (float(p[0]), float(p[1]), float(p[2])), "horizontal")
        for k, p in enumerate(place)
    )
    return Rig(lamps, tuple(made))


@pytest.fixture(scope="session")
def ball() -> Subject:
    return ball_subject()


@pytest.fixture(scope="session")
def tiny_rig() -> Rig:
    return small_rig()
