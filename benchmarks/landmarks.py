"""How far are detected landmarks from the true ones, on people of three kinds, and how fast?"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lightstage.rig import Camera, Rig, look_at
from processing.colour import srgb_from_linear
from sim.light.lamps import point_lamps
from sim.light.relight import auto_exposure
from sim.light.world import World
from sim.people.subject import Subject
from sim.truth import landmarks_px

PICTURE_PX = 512
AWAY_MM = 900.0
SHOWN_MM = 330.0
YAWS_DEG = (-40.0, -20.0, 0.0, 20.0, 40.0)
WHO = {"ours": (101, 102, 103), "ict": (101, 102, 103), "lps": (0,)}
"""Seeds of each kind of person; none of them was looked at when the table of indices was chosen."""
SOFT, HARD = 0.4, 0.02
"""Share of the light that comes from all round."""
LIGHTS: dict[str, tuple[float, float, float]] = {
    "all round": (0, 90, 1.0),
    "front": (0, 10, SOFT),
    "left": (-60, 20, SOFT),
    "right": (60, 20, SOFT),
    "above": (0, 70, SOFT),
    "below": (0, -50, SOFT),
    "back left": (-120, 20, SOFT),
    "hard left": (-75, 15, HARD),
    "hard right": (75, 15, HARD),
    "hard above": (20, 65, HARD),
}
"""Yaw to the person's left and pitch of the one lamp, degrees, and the share from all round."""
EYES = (36, 45)
JAW = slice(0, 17)


class Shot(NamedTuple):
    """A picture with what is known about it.

    Attributes:
        picture: (h, w, 3) uint8.
        true_px: (68, 2), NaN where hidden.
        eyes_px: distance of the outer corners of the eyes if they were seen from the front.
        yaw_deg: of the camera.
        light: its name.
    """

    picture: np.ndarray
    true_px: np.ndarray
    eyes_px: float
    yaw_deg: float
    light: str


def toward(yaw_deg: float, pitch_deg: float) -> np.ndarray:
    """(3,) unit."""
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    return np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])


def portrait_camera(middle_mm: np.ndarray, yaw_deg: float) -> Camera:
    place = middle_mm + AWAY_MM * toward(yaw_deg, 5.0)
    focal, half = PICTURE_PX * AWAY_MM / SHOWN_MM, PICTURE_PX / 2
    pose = np.array(look_at(place, middle_mm))
    dist = (0.0, 0.0, 0.0, 0.0, 0.0)
    size = (PICTURE_PX, PICTURE_PX)
    return Camera(f"yaw{yaw_deg:+.0f}", "", "", *size, focal, focal, half, half, dist, pose)


def lamp_places() -> np.ndarray:
    """(m, 3) the single lamps, then as many all round, mm."""
    single = [toward(yaw, pitch) for yaw, pitch, _ in LIGHTS.values()]
    rows = [(0, 8), (45, 5), (-35, 5)]
    around = [toward(360 * i / n, pitch) for pitch, n in rows for i in range(n)]
    return 1500.0 * np.array([*single, *around])


def shots_of(subject: Subject, rig: Rig) -> Iterator[Shot]:
    """Pictures of a person from all sides under all lights."""
    middle = np.nanmean(subject.landmarks_mm[17:], axis=0)
    cameras = tuple(portrait_camera(middle, yaw) for yaw in YAWS_DEG)
    places = lamp_places()
    one = rig.lights[0]
    lights = tuple(
        dataclasses.replace(one, id=i, name=str(i), position_mm=tuple(p), rgb_gain=(1.0, 1.0, 1.0))
        for i, p in enumerate(places)
    )
    stage = dataclasses.replace(rig, cameras=cameras, lights=lights)
    world = World(subject, stage, lamps=point_lamps(places))
    states = np.zeros((len(LIGHTS), len(places)))
    for index, (_, _, around) in enumerate(LIGHTS.values()):
        states[index, index] = 1 - around
        states[index, len(LIGHTS) :] = around / (len(places) - len(LIGHTS))
    eyes_mm = np.linalg.norm(np.subtract(*subject.landmarks_mm[list(EYES)]))
    for camera, yaw in zip(cameras, YAWS_DEG, strict=True):
        true = landmarks_px(world, camera, np.random.default_rng(0), 0.0)
        pictures = world.photograph(camera.id, states)
        for name, linear in zip(LIGHTS, pictures, strict=True):
            exposed = np.clip(linear * auto_exposure(linear), 0, 1)
            yield Shot(
                (255 * srgb_from_linear(exposed) + 0.5).astype(np.uint8),
                true,
                float(eyes_mm * camera.fx_px / AWAY_MM),
                yaw,
                name,
            )
