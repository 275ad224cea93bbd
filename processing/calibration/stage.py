"""A calibration from its photographs: flats, darks, colours, lights, colours by those lights."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import LightstageError, one_error
from lightstage.formats.environment import LightSet, stage_lights
from lightstage.formats.flats import FlatField
from lightstage.formats.lights import MeasuredLights
from lightstage.rig import Rig
from processing.calibration.ball import ball_shots
from processing.calibration.colour.all_cameras import (
    Seen,
    check_grey,
    fit_colours,
    see_charts,
)
from processing.calibration.colour.chart_reference import chart_reflectance
from processing.calibration.colour.config import ColourFitConfig, FlatConfig
from processing.calibration.colour.fit import ColourFit
from processing.calibration.colour.flats import fit_flat, read_darks
from processing.calibration.colour.white import white_at
from processing.calibration.config import CalibrateConfig
from processing.calibration.folder import Pose, Source
from processing.calibration.lights.fit import fit_lights
from processing.calibration.picture import read_mosaic
from processing.colour import ColourCorrection
from processing.errors import ProcessingError

BALLS = ("mirror", "grey")
GREY_WARNED = 0.03
"""A grey ball that reads farther from its reflectance is warned of, as a share."""


@dataclasses.dataclass(frozen=True)
class Calibration:
    """What was measured.

    Attributes:
        flats: camera id to its field; empty without flats and darks.
        colours: camera id to its correction; empty without a chart.
        fits: camera id to the fit that gave it.
        full_levels: (n,) what the chart was lit by; None without a chart.
        lights: measured lamps, and the rig whose lamps they are; None without a ball under more
            than one pattern.
        facts: JSON-ready, by part.
        warnings: sentences for the user.
    """

    flats: dict[str, FlatField]
    colours: dict[str, ColourCorrection]
    fits: dict[str, ColourFit]
    full_levels: np.ndarray | None
    lights: tuple[MeasuredLights, Rig] | None
    facts: dict[str, Any]
    warnings: list[str]


def calibrate(
    source: Source, config: CalibrateConfig, progress: ProgressCallback = quiet
) -> Calibration:
    """Measure all that the photographs show.

    Raises:
        ProcessingError: nothing to measure, or every camera whose photographs will not do, in one
            message.
    """
    poses = source.poses
    balls = {kind: [p for p in poses.get(kind, []) if len(p.patterns) > 1] for kind in BALLS}
    if not any(kind in poses for kind in ("chart", "flat", "dark")) and not any(balls.values()):
        raise ProcessingError(
            source.root,
            found=f"shots of {', '.join(poses)}",
            expected="shots of a chart, a flat card, the dark, or a ball under several patterns",
            hint="Take them: `lightstage calibrate chart --out LAB`.",
        )
    warnings = list(source.warnings)
    facts: dict[str, Any] = {}
    flats = _flats(poses, config.flat, facts, warnings)
    seen = see_charts(poses["chart"], flats, config.chart, progress) if "chart" in poses else {}
    known = chart_reflectance(config.chart.reference)
    full = _levels(next(iter(seen.values())).pose) if seen else None
    fits = _fits(seen, full, None, known, config.colour)
    lights = None
    if any(balls.values()):
        rig = next(pose for kind in BALLS for pose in balls[kind]).session.rig
        raw = {name: fit.correction for name, fit in fits.items()}
        shots = {
            kind: [ball_shots(pose.session, raw, pose.patterns, flats) for pose in balls[kind]]
            for kind in BALLS
        }
        measured = fit_lights(rig, shots["mirror"], shots["grey"], config.lights, progress)
        lights = measured, rig
        facts["lights"] = dict(measured.facts)
        fits = _fits(seen, full, lights, known, config.colour)
    colours = {name: fit.correction for name, fit in fits.items()}
    if fits and full is not None:
        facts["colour"] = {name: fit.facts | _facts(seen[name]) for name, fit in fits.items()}
        warnings += _colour_warnings(fits)
        if "grey" in poses:
            pose = poses["grey"][0]
            shone = lights_of(pose, full, lights)
            colours, facts["grey"] = check_grey(pose, colours, flats, shone, config.grey)
            if facts["grey"]["largest_error"] > GREY_WARNED:
                share = 100 * facts["grey"]["largest_error"]
                warnings.append(f"the grey ball reads {share:.1f} % away from its reflectance")
    else:
        warnings.append("no shots of the colour chart: no colours")
    return Calibration(flats, colours, fits, full, lights, facts, warnings)


def _flats(
    poses: dict[str, list[Pose]],
    config: FlatConfig,
    facts: dict[str, Any],
    warnings: list[str],
) -> dict[str, FlatField]:
    """Fields of all cameras that a card or the dark was photographed with."""
    fields: dict[str, FlatField] = {}
    problems: list[LightstageError] = []
    for kind in ("flat", "dark"):
        own: dict[str, list[Pose]] = {}
        for pose in poses.get(kind, []):
            for name in pose.session.camera_ids():
                if pose.faces in (None, name):
                    own.setdefault(name, []).append(pose)
        for name, seen in own.items():
            camera = seen[0].session.rig.camera(name)
            where = f"{kind}, {name}"
            try:
                mosaics = [read_mosaic(pose.photograph(name)) for pose in seen]
                if kind == "flat":
                    fields[name], field_facts = fit_flat(mosaics, camera, config, where)
                    if field_facts["residual_rms"] > config.max_residual:
                        warnings.append(
                            f"{where}: uneven by {100 * field_facts['residual_rms']:.1f} %"
                        )
                else:
                    field = fields.get(name, FlatField.even(camera, mosaics[0].orientation))
                    fields[name], field_facts = read_darks(mosaics, field, config, where)
                    offset = max(abs(value) for value in field_facts["black_offset"])
                    if offset > config.max_black_offset:
                        warnings.append(
                            f"{where}: black is {100 * offset:.3f} % of white off the "
                            "files' own; it is corrected"
                        )
                facts.setdefault(kind, {})[name] = field_facts
            except LightstageError as error:
                problems.append(error)
    if problems:
        raise one_error(problems)
    return fields


def _levels(pose: Pose) -> np.ndarray:
    """(n,) what a pose's first pattern was lit by."""
    return np.asarray(pose.session.levels(pose.patterns[0]), float)


def lights_of(
    pose: Pose, full: np.ndarray, measured: tuple[MeasuredLights, Rig] | None
) -> LightSet:
    """What shone on a pose, on the scale on which a white under `full` reads 1.

    Args:
        pose: its first pattern.
        full: (n,) levels that the scale is made by.
        measured: lamps and the rig whose they are; None takes the pose's own rig as it is.

    Returns:
        (n',) lamps that were lit, by place and by what each gives to the origin.
    """
    rig = pose.session.rig
    if measured is None:
        return stage_lights(rig, _levels(pose), pose.where, full)
    lamps, own = measured
    where = {light.id: index for index, light in enumerate(own.lights)}
    lights = tuple(
        dataclasses.replace(
            light,
            position_mm=tuple(lamps.position_mm[where[light.id]].tolist()),
            rgb_gain=tuple(lamps.rgb_gain[where[light.id]].tolist()),
        )
        if light.id in where
        else light
        for light in rig.lights
    )
    shone = stage_lights(dataclasses.replace(rig, lights=lights), _levels(pose), pose.where, full)
    # Only differences between lamps were measured: white is 1 in each channel by what a scale is.
    whole = stage_lights(dataclasses.replace(rig, lights=lights), full, "full", full)
    white = white_at(np.zeros((1, 3)), np.array([0.0, 0.0, 1.0]), whole)[0]
    return dataclasses.replace(shone, rgb=shone.rgb / white)


def _fits(
    seen: dict[str, Seen],
    full: np.ndarray | None,
    measured: tuple[MeasuredLights, Rig] | None,
    known: np.ndarray,
    config: ColourFitConfig,
) -> dict[str, ColourFit]:
    """Fits of all cameras that saw a chart."""
    if full is None:
        return {}
    lights = {each.pose.where: lights_of(each.pose, full, measured) for each in seen.values()}
    return fit_colours(seen, lights, known, config)


def _facts(seen: Seen) -> dict[str, Any]:
    """Where a camera's chart comes from."""
    return {
        "pose": seen.pose.where,
        "tilt_deg": round(seen.tilt_deg, 2),
        "patches_fit_px": round(2 * seen.view.fit_px, 3),
        "exposure": seen.exposure,
    }


def _colour_warnings(fits: dict[str, ColourFit]) -> list[str]:
    """Warnings about the fits of colour."""
    warnings = []
    for name, fit in fits.items():
        for why, patches in fit.facts["left_out"].items():
            if patches:
                numbers = ", ".join(str(patch) for patch in patches)
                warnings.append(
                    f"chart, {name}: patches {numbers} left out, {why.replace('_', ' ')}"
                )
        if fit.facts["delta_e"]["mean"] > 3:
            warnings.append(
                f"chart, {name}: Delta E {fit.facts['delta_e']['mean']:.1f} in the mean; is it the "
                "chart of the configuration?"
            )
    return warnings
