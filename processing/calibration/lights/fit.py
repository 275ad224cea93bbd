"""Calibration shots of mirror and grey ball to measured lights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.lights import MeasuredLights
from lightstage.rig import Rig
from processing.calibration.ball import BallShots, Steps
from processing.calibration.lights.config import LightsConfig
from processing.calibration.lights.flux import intensities
from processing.calibration.lights.grey_ball import (
    Gains,
    Readings,
    expected_gains,
    solve_gains,
)
from processing.calibration.lights.grey_shots import joined, read_grey_ball
from processing.calibration.lights.mirror_ball import Placed, solve_lamps
from processing.calibration.lights.mirror_shots import see_highlights
from processing.calibration.lights.ratios import (
    corrected,
    errors_deg,
    fit_ratios,
    lamp_normals,
    ratio_vectors,
)
from processing.errors import ProcessingError
from processing.lighting.lamps import NO_STRAY, Lamps
from processing.lighting.lights import lights_of
from processing.vectors import unit

AXES = ("x", "y", "z")


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
    steps = Steps(progress, total)
    count = len(rig.lights)
    facts: dict[str, Any] = {}
    position, known = rig.positions_mm, (np.full((count, 3), np.nan), np.full(count, np.inf))
    sigma_mm, residual = np.full(count, config.mirror.position_sigma_mm), np.full(count, np.nan)
    if mirror:
        seen = [
            s
            for pose, shots in enumerate(mirror)
            for s in see_highlights(shots, pose, config.mirror, steps)
        ]
        placed = solve_lamps(seen, position, config.mirror, str(mirror[0].where))
        known = intensities(placed.flux, count)
        position, sigma_mm, residual = placed.position_mm, placed.sigma_mm, placed.residual_px
        facts["mirror"] = _mirror_facts(placed, rig, len(mirror))
    log, sigma = expected_gains(*known, config.grey)
    gains = Gains(np.exp(log), sigma, config.grey.exponent, config.grey.exponent_sigma, {}, 0, 0, 0)
    if grey:
        readings = joined([read_grey_ball(shots, config.grey, steps) for shots in grey])
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
