"""Photographs of balls by the simulator's own hand, as calibration takes them."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from lightstage.patterns import pattern_levels
from lightstage.rig import Camera, Rig, default_rig
from processing.calibration.ball import BallShots, Picture
from processing.calibration.lights.highlights import Highlights
from processing.calibration.lights.mirror_ball import Seen
from processing.lighting.lamps import measured_rig
from sim.light.lamps import Lamps
from sim.targets.ball import Ball, highlights_mm, photograph_grey, photograph_mirror

RADIUS_MM = 38.1


def small_rig(cameras: int, factor: float) -> Rig:
    """The default rig with fewer and smaller cameras."""
    rig = default_rig().scaled(factor)
    return dataclasses.replace(rig, cameras=rig.cameras[:cameras])


def displaced(rig: Rig, sigma_mm: float, seed: int = 1) -> Rig:
    """The rig as it really stands: its lights elsewhere than it says."""
    rng = np.random.default_rng(seed)
    places = rig.positions_mm + rng.normal(size=(len(rig.lights), 3)) * sigma_mm
    return measured_rig(rig, places, rig.rgb_gains)


def take(
    rig: Rig,
    lamps: Lamps,
    kind: str,
    place_mm: tuple[float, float, float],
    patterns: tuple[str, ...],
    *,
    room: float = 0.0,
    noise: float = 1e-3,
    radius_mm: float = RADIUS_MM,
) -> BallShots:
    """Photographs of a ball with the simulator's light and noise, each taken when it is read."""
    mirror = kind == "mirror"
    ball = Ball(np.array(place_mm, float), radius_mm, 0.6 if mirror else 0.18)
    photograph = photograph_mirror if mirror else photograph_grey
    levels = {name: pattern_levels(name, rig) for name in patterns}
    ambient = np.full(3, room)

    def light(name: str, camera: Camera) -> np.ndarray:
        return photograph(ball, camera, lamps, levels[name], ambient)[0]

    brightest = 1.1 * float(light(patterns[0], rig.cameras[0]).max())

    @functools.cache
    def read(name: str, camera_id: str) -> Picture:
        camera = rig.camera(camera_id)
        seed = [len(camera_id), list(levels).index(name), rig.cameras.index(camera)]
        rng = np.random.default_rng(seed)
        shown = light(name, camera) / brightest
        shown = shown + noise * np.sqrt(0.02 + shown) * rng.normal(size=shown.shape)
        return Picture(shown.astype(np.float32), np.asarray((shown < 1).all(axis=2)), camera)

    return BallShots(Path(kind), levels, tuple(c.id for c in rig.cameras), read)


def sightings(
    rig: Rig, lamps_mm: np.ndarray, ball: Ball, pose: int, noise_px: float, seed: int = 0
) -> list[Seen]:
    """Highlights where the simulator's solution of Alhazen's problem has them, with noise."""
    rng = np.random.default_rng([seed, pose])
    count = len(lamps_mm)
    out = []
    for camera in rig.cameras:
        pixels = camera.project(highlights_mm(ball, camera, lamps_mm))[0]
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        pixels = pixels + noise_px * rng.normal(size=pixels.shape)
        found = Highlights(pixels, np.ones((len(pixels), 3)))
        unknown = np.full((len(pixels), 3), np.nan)
        nobody = np.full(len(pixels), -1)
        signature = np.full((count, 3), np.nan)
        out.append(Seen(pose, camera, found, nobody, unknown, signature, np.ones(count), 0.0))
    return out
