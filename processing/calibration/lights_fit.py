"""Calibration shots of mirror and grey ball to measured lights."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.lights import MeasuredLights
from lightstage.patterns import complement
from lightstage.rig import Camera, Rig
from processing.calibration.ball import BallShots, Picture, find_ball, radius_px, sphere_hits
from processing.calibration.grey_ball import (
    LEAST_FACING,
    Gains,
    GreyConfig,
    Readings,
    expected_gains,
    solve_gains,
)
from processing.calibration.highlights import Highlights, find_highlights, flux_at
from processing.calibration.mirror_ball import (
    MirrorConfig,
    Placed,
    Seen,
    intensities,
    solve_lamps,
)
from processing.calibration.ratios import (
    corrected,
    errors_deg,
    fit_ratios,
    lamp_normals,
    ratio_vectors,
    unit,
)
from processing.errors import ProcessingError
from processing.lamps import NO_STRAY, Lamps
from processing.lights import lights_of

AXES = ("x", "y", "z")
SUMS_TO = 1e-3
"""Levels of a pair may differ from those of the whole by this and still sum to it."""


@dataclasses.dataclass(frozen=True)
class LightsConfig:
    """How lights are measured."""

    mirror: MirrorConfig = dataclasses.field(default_factory=MirrorConfig)
    grey: GreyConfig = dataclasses.field(default_factory=GreyConfig)


def fit_lights(
    rig: Rig,
    mirror: Sequence[BallShots],
    grey: Sequence[BallShots],
    config: LightsConfig | None = None,
    progress: ProgressCallback = quiet,
) -> MeasuredLights:
    """Measure a rig's lights.

    Positions come from the mirror ball, gains from its highlights and the grey ball, stray light
    and fall-off from the grey ball. Without a mirror ball positions are the rig's; without a grey
    one gains are the highlights'.

    Args:
        rig: lights and cameras.
        mirror: poses of a mirror ball: under every light with linear gradients, or light by light.
        grey: poses of a grey ball: under every light and under binary gradients.
        config: the balls.
        progress: of the photographs.

    Raises:
        ProcessingError: no shots at all, or shots that do not show what they should.
        FormatError: a photograph that cannot be read.
    """
    config = config or LightsConfig()
    if not mirror and not grey:
        raise ProcessingError(
            "calibration",
            found="no shots of a mirror ball or a grey ball",
            expected="some of one of them",
            hint="lightstage calibrate mirror; lightstage calibrate grey.",
        )
    total = sum(len(shots.levels) * len(shots.cameras) for shots in (*mirror, *grey))
    steps = _Steps(progress, total)
    count = len(rig.lights)
    facts: dict[str, Any] = {}
    position, known = rig.positions_mm, (np.full((count, 3), np.nan), np.full(count, np.inf))
    sigma_mm, residual = np.full(count, config.mirror.position_sigma_mm), np.full(count, np.nan)
    if mirror:
        seen = [s for pose, shots in enumerate(mirror) for s in _seen(shots, pose, config, steps)]
        placed = solve_lamps(seen, position, config.mirror, str(mirror[0].where))
        known = intensities(placed.flux, count)
        position, sigma_mm, residual = placed.position_mm, placed.sigma_mm, placed.residual_px
        facts["mirror"] = _mirror_facts(placed, rig, len(mirror))
    log, sigma = expected_gains(*known, config.grey)
    gains = Gains(np.exp(log), sigma, config.grey.exponent, config.grey.exponent_sigma, {}, 0, 0, 0)
    if grey:
        readings = _joined([_readings(shots, config, steps) for shots in grey])
        gains = solve_gains(readings, position, *known, config.grey)
        facts["grey"] = _grey_facts(readings, gains, position, rig)
    rgb = gains.rgb / gains.rgb.mean(axis=0)
    facts["lights"] = {
        "gain_spread": round(float(rgb.mean(axis=1).std()), 4),
        "colour_spread": round(
            float((rgb / rgb.mean(axis=1, keepdims=True)).std(axis=0).mean()), 4
        ),
        "exponent": round(gains.exponent, 3),
        "exponent_sigma": round(gains.exponent_sigma, 3),
        "exponent_from": "grey ball" if gains.exponent != config.grey.exponent else "assumed",
    }
    return MeasuredLights(
        position_mm=position,
        rgb_gain=rgb,
        exponent=gains.exponent,
        stray=gains.stray,
        position_sigma_mm=sigma_mm,
        residual_px=residual,
        gain_sigma=gains.sigma,
        facts=facts,
    )


class _Steps:
    """Counts photographs."""

    def __init__(self, progress: ProgressCallback, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def one(self) -> None:
        self._done += 1
        self._progress(self._done, self._total)


def _whole(shots: BallShots) -> str:
    """The pattern of most light."""
    return max(shots.levels, key=lambda name: float(shots.levels[name].sum()))


def _seen(shots: BallShots, pose: int, config: LightsConfig, steps: _Steps) -> list[Seen]:
    """Highlights of one pose in every camera."""
    own = config.mirror
    singles = {n: int(v.argmax()) for n, v in shots.levels.items() if np.count_nonzero(v) == 1}
    out = []
    for camera_id in shots.cameras:
        if singles:
            out += _single_highlights(shots, pose, camera_id, singles, own, steps)
            continue
        whole = _whole(shots)
        picture = shots.read(whole, camera_id)
        steps.one()
        reach = max(2.0, own.window_share * radius_px(picture.camera, own.radius_mm))
        found = find_highlights(picture, reach, own.floor_share, own.noise_times)
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
    config: MirrorConfig,
    steps: _Steps,
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
    shots: BallShots, camera_id: str, found: Highlights, reach: float, steps: _Steps
) -> tuple[np.ndarray, np.ndarray]:
    """What linear gradients tell of each highlight, and the same of each lamp's levels."""
    count = len(next(iter(shots.levels.values())))
    told, known = np.full((len(found.place_px), 3), np.nan), np.full((count, 3), np.nan)
    for k, axis in enumerate(AXES):
        names = [f"lin-{axis}{sign}" for sign in "+-"]
        if not all(name in shots.levels for name in names):
            continue
        light = []
        for name in names:
            picture = shots.read(name, camera_id)
            steps.one()
            light.append(flux_at(picture, found.place_px, reach).mean(axis=1))
        told[:, k] = _difference(*light)
        known[:, k] = _difference(*(shots.levels[name] for name in names))
    # Told in part is not told: a chord of one axis would let others pass.
    told[np.isnan(told).any(axis=1)] = np.nan
    return told, known


def _difference(plus: np.ndarray, minus: np.ndarray) -> np.ndarray:
    total = plus + minus
    return np.where(total > 0, (plus - minus) / np.where(total > 0, total, 1), np.nan)


def _readings(shots: BallShots, config: LightsConfig, steps: _Steps) -> Readings:
    """Places of one pose of a grey ball."""
    whole = _whole(shots)
    pictures = {camera_id: shots.read(whole, camera_id) for camera_id in shots.cameras}
    outline = find_ball(list(pictures.values()), config.grey.radius_mm, shots.where)
    if abs(outline.radius_mm / config.grey.radius_mm - 1) > 0.05:
        raise ProcessingError(
            shots.where,
            field="radius_mm",
            found=f"a grey ball of {outline.radius_mm:.1f} mm radius in the photographs",
            expected=f"{config.grey.radius_mm:g} mm",
            hint="Measure the ball and tell its radius.",
        )
    patterns = tuple(shots.levels)
    parts = []
    for index, camera_id in enumerate(shots.cameras):
        part = _part(pictures[camera_id].camera, outline.centre_mm, outline.radius_mm, config.grey)
        if part is None:
            steps.one()
            continue
        shown = []
        for name in patterns:
            picture = pictures[camera_id] if name == whole else shots.read(name, camera_id)
            steps.one()
            shown.append(part.light(picture))
        parts.append((part, np.stack(shown, axis=1), np.full(len(part.points), index)))
    points, normals = (
        np.concatenate([getattr(p[0], k) for p in parts]) for k in ("points", "normals")
    )
    rgb, group = (np.concatenate([p[k] for p in parts]) for k in (1, 2))
    levels = np.stack([shots.levels[name] for name in patterns])
    rgb = rgb - _ambient(rgb, normals, group, patterns, levels, whole)
    good = np.isfinite(rgb).all(axis=(1, 2))
    group = np.unique(group[good], return_inverse=True)[1]
    return Readings(patterns, levels, points[good], normals[good], rgb[good].astype(float), group)


@dataclasses.dataclass(frozen=True)
class _Part:
    """The part of a picture that shows the ball, binned to few places."""

    rows: slice
    columns: slice
    factor: int
    mask: np.ndarray
    points: np.ndarray
    normals: np.ndarray

    def light(self, picture: Picture) -> np.ndarray:
        """(n, 3) mean light of the places; NaN where a pixel of them is not valid."""
        rgb = np.where(picture.valid[..., None], picture.rgb, np.nan)[self.rows, self.columns]
        return np.asarray(_blocks(rgb, self.factor).mean(axis=(1, 3))[self.mask], float)


def _part(
    camera: Camera, centre_mm: np.ndarray, radius_mm: float, config: GreyConfig
) -> _Part | None:
    """Where a camera shows a ball; None where it does not show the whole of it."""
    size = radius_px(camera, radius_mm)
    factor = max(1, int(size * np.sqrt(np.pi / config.places)))
    middle = camera.project(centre_mm[None])[0][0]
    side = int(np.ceil(size / factor)) + 1
    left, top = (round(value - side * factor) for value in middle)
    wide = 2 * side * factor
    if left < 0 or top < 0 or left + wide > camera.width_px or top + wide > camera.height_px:
        return None
    part = dataclasses.replace(
        camera, width_px=wide, height_px=wide, cx_px=camera.cx_px - left, cy_px=camera.cy_px - top
    )
    origin, rays = part.pixel_rays()
    flat = rays.reshape(-1, 3)
    points, hit = sphere_hits(centre_mm, radius_mm, origin, flat)
    normals = (points - centre_mm) / radius_mm
    good = hit & (np.einsum("nk,nk->n", normals, -flat) > LEAST_FACING)
    whole = np.asarray(_blocks(good.reshape(wide, wide), factor).all(axis=(1, 3)))
    # Light is nearly linear in the normal: a place's mean light is that of its mean normal.
    points, normals = (
        _blocks(value.reshape(wide, wide, 3), factor).mean(axis=(1, 3))[whole]
        for value in (points, normals)
    )
    rows, columns = slice(top, top + wide), slice(left, left + wide)
    return _Part(rows, columns, factor, whole, points, normals)


def _blocks(values: np.ndarray, factor: int) -> np.ndarray:
    """(h, w[, k]) values as (h / factor, factor, w / factor, factor[, k])."""
    height, width = (side // factor for side in values.shape[:2])
    return values.reshape(height, factor, width, factor, *values.shape[2:])


def _ambient(
    rgb: np.ndarray,
    normals: np.ndarray,
    group: np.ndarray,
    patterns: tuple[str, ...],
    levels: np.ndarray,
    whole: str,
) -> np.ndarray:
    """(n, 1, 3) the room's light: what a pair shows beyond every light's, smooth over the ball."""
    full = patterns.index(whole)
    extra = []
    for k, name in enumerate(patterns):
        mate = complement(name)
        if mate not in patterns[k + 1 :]:
            continue
        other = patterns.index(mate)
        if np.abs(levels[k] + levels[other] - levels[full]).max() < SUMS_TO:
            extra.append(rgb[:, k] + rgb[:, other] - rgb[:, full])
    out = np.zeros((len(rgb), 1, 3))
    if not extra:
        return out
    room = np.mean(extra, axis=0)
    terms = np.concatenate([np.ones((len(normals), 1)), normals], axis=1)
    for g in np.unique(group):
        own = (group == g) & np.isfinite(room).all(axis=1)
        if own.sum() > 20:
            fitted = np.linalg.lstsq(terms[own], room[own], rcond=None)[0]
            out[group == g, 0] = np.maximum(terms[group == g] @ fitted, 0)
    return out


def _joined(parts: list[Readings]) -> Readings:
    """Readings of several poses under the same patterns."""
    first = parts[0]
    for part in parts[1:]:
        if part.patterns != first.patterns or np.abs(part.levels - first.levels).max() > SUMS_TO:
            raise ProcessingError(
                "grey ball",
                found=f"patterns {', '.join(part.patterns)} in one pose",
                expected=f"{', '.join(first.patterns)} as in the first one, driven alike",
            )
    shift = np.cumsum([0] + [int(part.group.max()) + 1 for part in parts[:-1]])
    return Readings(
        first.patterns,
        first.levels,
        np.concatenate([part.points_mm for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.rgb for part in parts]),
        np.concatenate([part.group + by for part, by in zip(parts, shift, strict=True)]),
    )


def _mirror_facts(placed: Placed, rig: Rig, poses: int) -> dict[str, Any]:
    moved = np.linalg.norm(placed.position_mm - rig.positions_mm, axis=1)
    return {
        "poses": poses,
        "highlights": int(placed.sightings.sum()),
        "lights_not_seen": int((placed.sightings == 0).sum()),
        "residual_px": round(placed.rms_px, 3),
        "ball_radius_mm": round(placed.radius_mm, 3),
        "ball_places_mm": placed.centres_mm.round(2).tolist(),
        "position_sigma_mm": round(float(np.median(placed.sigma_mm)), 2),
        "moved_from_nominal_mm": round(float(np.sqrt(np.mean(moved**2))), 2),
    }


def _grey_facts(readings: Readings, gains: Gains, position: np.ndarray, rig: Rig) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "places": len(readings.points_mm),
        "error_nominal_gains": round(gains.before, 5),
        "error_measured_gains": round(gains.after, 5),
        "error_with_stray": round(gains.left, 5),
        "gain_sigma": round(float(np.median(gains.sigma)), 4),
    }
    if all(a + sign in readings.patterns for a in AXES for sign in "+-"):
        facts["normals_deg"] = normal_errors(
            readings,
            {
                "nominal": Lamps(
                    rig.positions_mm, _even(rig.positions_mm), 0.0, NO_STRAY, "nominal"
                ),
                "measured": Lamps(
                    position,
                    _even(position) * gains.rgb,
                    gains.exponent,
                    gains.stray,
                    "measured",
                ),
            },
        )
    return facts


def _even(position: np.ndarray) -> np.ndarray:
    """(L, 3) what a white at the origin reads of lamps of equal intensity."""
    return np.repeat(1e6 / np.sum(position**2, axis=1)[:, None], 3, axis=1)


def normal_errors(readings: Readings, lamps: dict[str, Lamps]) -> dict[str, float]:
    """Mean error of a ball's normals in degrees: by ratios as they are, corrected, and by lamps.

    Corrections are fitted on every other place and judged on the others.
    """
    ratios = ratio_vectors(readings)
    good = np.isfinite(ratios).all(axis=1)
    learn = good & (np.arange(len(ratios)) % 2 == 0)
    judge = good & ~learn
    normals = unit(readings.normals)
    found = {"plain": unit(ratios)}
    for degree, name in ((1, "affine"), (2, "quadratic")):
        found[name] = corrected(ratios, fit_ratios(ratios[learn], normals[learn], degree))
    for name, each in lamps.items():
        found[name] = lamp_normals(readings, lights_of(each, readings.patterns, readings.levels))
    return {
        name: round(float(errors_deg(value[judge], normals[judge]).mean()), 3)
        for name, value in found.items()
    }
