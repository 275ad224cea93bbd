"""Plain pictures of a coloured mesh: light from a few sides with shadows, seen all round."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import open3d

from learning.render.view import scene_of
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.rig import Camera, look_at
from processing.colour import srgb_from_linear

PICTURE_PX = 448
FINER = 2
"""Rays a side of a pixel."""
AWAY_MM = 900.0
SHOWN_MM = 330.0
"""Height of what a picture shows, around the middle of the face."""
BACKGROUND = 0.18


class Lamp(NamedTuple):
    """Where light comes from.

    Attributes:
        yaw_deg: to the person's left.
        pitch_deg: up.
        ambient: share of the light that comes from everywhere.
    """

    yaw_deg: float
    pitch_deg: float
    ambient: float


@dataclasses.dataclass(frozen=True)
class Coloured:
    """A mesh with the colours of its vertices, ready for rays.

    Attributes:
        mesh: mm, face toward +z, +y up.
        colours: (n, 3) linear.
        middle_mm: (3,) of the face.
    """

    mesh: Mesh
    colours: np.ndarray
    middle_mm: np.ndarray

    def __post_init__(self) -> None:
        """Build what rays are cast at."""
        triangles = self.mesh.triangles()
        object.__setattr__(self, "scene", scene_of(self.mesh))
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "normals", vertex_normals(self.mesh.vertices, triangles))

    scene: open3d.t.geometry.RaycastingScene = dataclasses.field(init=False)
    triangles: np.ndarray = dataclasses.field(init=False)
    normals: np.ndarray = dataclasses.field(init=False)


def direction(yaw_deg: float, pitch_deg: float) -> np.ndarray:
    """(3,) unit, from the face towards a place to its left and above."""
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    return np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])


def camera_at(middle_mm: np.ndarray, yaw_deg: float, pitch_deg: float) -> Camera:
    """A camera that is aimed at a (3,) point of the face, mm, from a direction."""
    place = middle_mm + AWAY_MM * direction(yaw_deg, pitch_deg)
    focal = PICTURE_PX * AWAY_MM / SHOWN_MM
    centre = PICTURE_PX / 2
    return Camera(
        id=f"{yaw_deg:+.0f}{pitch_deg:+.0f}",
        serial="",
        model="rendered",
        width_px=PICTURE_PX,
        height_px=PICTURE_PX,
        fx_px=focal,
        fy_px=focal,
        cx_px=centre,
        cy_px=centre,
        dist=(0.0, 0.0, 0.0, 0.0, 0.0),
        cam_from_world=np.array(look_at(place, middle_mm)),
    )


def pictures_of(head: Coloured, camera: Camera, lamps: list[Lamp]) -> list[np.ndarray]:
    """Pictures of a head in one view under one lamp after the other.

    Args:
        head: the mesh and its colours.
        camera: the view.
        lamps: lights.

    Returns:
        (h, w, 3) uint8 sRGB each, exposed for skin in full light.
    """
    width, height = FINER * camera.width_px, FINER * camera.height_px
    columns = (np.arange(width) + 0.5) / FINER
    rows = (np.arange(height) + 0.5) / FINER
    rays = np.empty((height * width, 6), np.float32)
    rays[:, :3] = camera.centre_mm
    rays[:, 3:] = camera.rays_through(*np.meshgrid(columns, rows)).reshape(-1, 3)
    found = head.scene.cast_rays(open3d.core.Tensor(rays))
    distance = found["t_hit"].numpy()
    hit = np.isfinite(distance)
    uv = found["primitive_uvs"].numpy()[hit]
    weights = np.column_stack([1 - uv.sum(axis=1), uv])
    corners = head.triangles[found["primitive_ids"].numpy()[hit]]
    albedo = np.einsum("nc,nck->nk", weights, head.colours[corners])
    normal = np.einsum("nc,nck->nk", weights, head.normals[corners])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    place = rays[hit, :3] + distance[hit, None] * rays[hit, 3:]
    out = []
    for lamp in lamps:
        light = direction(lamp.yaw_deg, lamp.pitch_deg)
        again = np.empty((len(place), 6), np.float32)
        again[:, :3], again[:, 3:] = place + 0.5 * normal, light
        dark = head.scene.test_occlusions(open3d.core.Tensor(again)).numpy()
        direct = np.clip(normal @ light, 0, 1) * ~dark
        # The sky is brighter than the ground.
        shade = lamp.ambient * (0.7 + 0.3 * normal[:, 1]) + (1 - lamp.ambient) * direct
        linear = np.full((height * width, 3), BACKGROUND, np.float32)
        linear[hit] = 1.6 * shade[:, None] * albedo
        mean = linear.reshape(camera.height_px, FINER, camera.width_px, FINER, 3).mean(axis=(1, 3))
        out.append((255 * srgb_from_linear(np.clip(mean, 0, 1)) + 0.5).astype(np.uint8))
    return out
