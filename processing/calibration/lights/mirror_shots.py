"""Photographs of a mirror ball to highlights: which lamp each may be, and how bright it is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lightstage.rig import Camera
from processing.calibration.ball import BallShots, Steps, radius_px, whole_pattern
from processing.calibration.lights.config import MirrorBallConfig
from processing.calibration.lights.highlights import Highlights, find_highlights, flux_at
from processing.calibration.lights.mirror_ball import Seen

AXES = ("x", "y", "z")


def single_lights(levels: Mapping[str, np.ndarray]) -> dict[str, int]:
    """Patterns that light one lamp, and its place in the rig; (n,) levels by pattern."""
    return {name: int(v.argmax()) for name, v in levels.items() if np.count_nonzero(v) == 1}


def see_highlights(
    shots: BallShots, pose: int, config: MirrorBallConfig, steps: Steps
) -> list[Seen]:
    """Highlights of one pose in every camera."""
    singles = single_lights(shots.levels)
    out = []
    for camera_id in shots.cameras:
        if singles:
            out += _single_highlights(shots, pose, camera_id, singles, config, steps)
            continue
        whole = whole_pattern(shots)
        picture = shots.read(whole, camera_id)
        steps.one()
        reach = max(2.0, config.window_share * radius_px(picture.camera, config.radius_mm))
        found = find_highlights(picture, reach, config.floor_share, config.noise_times)
        toward, signature = _gradients(shots, camera_id, found, reach, steps)
        lamp = np.full(len(toward), -1)
        level = shots.levels[whole]
        apart = 2 * reach + 1
        out.append(Seen(pose, picture.camera, found, lamp, toward, signature, level, apart))
    return out


def _single_highlights(
    shots: BallShots,
    pose: int,
    camera_id: str,
    singles: dict[str, int],
    config: MirrorBallConfig,
    steps: Steps,
) -> list[Seen]:
    """Highlights of lights photographed one by one: each is its picture's brightest."""
    count = len(next(iter(shots.levels.values())))
    places, flux, lamps, level = [], [], [], np.zeros(count)
    camera: Camera | None = None
    for name, lamp in singles.items():
        picture = shots.read(name, camera_id)
        steps.one()
        camera = picture.camera
        reach = max(2.0, config.window_share * radius_px(camera, config.radius_mm))
        found = find_highlights(picture, reach, 0.5, config.noise_times)
        level[lamp] = shots.levels[name][lamp]
        if len(found.place_px) == 1:
            places.append(found.place_px[0])
            flux.append(found.flux[0])
            lamps.append(lamp)
    if camera is None:
        return []
    found = Highlights(np.array(places).reshape(-1, 2), np.array(flux).reshape(-1, 3))
    unknown = np.full((len(lamps), 3), np.nan)
    signature = np.full((count, 3), np.nan)
    return [Seen(pose, camera, found, np.array(lamps, int), unknown, signature, level, 0.0)]


def _gradients(
    shots: BallShots, camera_id: str, found: Highlights, reach: float, steps: Steps
) -> tuple[np.ndarray, np.ndarray]:
    """The places of highlights by linear gradients, and the same of each lamp's levels."""
    count = len(next(iter(shots.levels.values())))
    gradients, known = np.full((len(found.place_px), 3), np.nan), np.full((count, 3), np.nan)
    for k, axis in enumerate(AXES):
        names = [f"lin-{axis}{sign}" for sign in "+-"]
        if not all(name in shots.levels for name in names):
            continue
        light = []
        for name in names:
            picture = shots.read(name, camera_id)
            steps.one()
            light.append(flux_at(picture, found.place_px, reach).mean(axis=1))
        gradients[:, k] = _difference(*light)
        known[:, k] = _difference(*(shots.levels[name] for name in names))
    # A place with one coordinate is no place: a chord of one axis would let others pass.
    gradients[np.isnan(gradients).any(axis=1)] = np.nan
    return gradients, known


def _difference(plus: np.ndarray, minus: np.ndarray) -> np.ndarray:
    total = plus + minus
    return np.where(total > 0, (plus - minus) / np.where(total > 0, total, 1), np.nan)
