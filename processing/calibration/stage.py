"""A calibration from its photographs: flats and darks first, then colours, then the grey ball."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import LightstageError, one_error
from lightstage.formats.environment import LightSet, stage_lights
from lightstage.formats.files import atomic_folder, write_json
from processing.calibration.chart_reference import chart_reflectance
from processing.calibration.colour_fit import ColourFit, ColourFitConfig
from processing.calibration.colours import ChartConfig, Seen, check_grey, fit_colours
from processing.calibration.flat_file import FlatField, write_flats
from processing.calibration.flats import FlatConfig, fit_flat, read_darks
from processing.calibration.folder import Pose, Source
from processing.calibration.grey import GreyConfig
from processing.calibration.picture import read_mosaic
from processing.calibration.swatches import write_swatches
from processing.colour import SCHEMA as COLOUR_SCHEMA
from processing.colour import ColourCorrection
from processing.errors import ProcessingError
from processing.records import versions

SCHEMA = "lightstage.calibration/1"
NAME = "calibration.json"
COLOUR, FLATS = "colour.json", "flats.json"


@dataclasses.dataclass(frozen=True)
class CalibrateConfig:
    """What `calibrate` may be told; a table of its TOML file each."""

    chart: ChartConfig = dataclasses.field(default_factory=ChartConfig)
    colour: ColourFitConfig = dataclasses.field(default_factory=ColourFitConfig)
    flat: FlatConfig = dataclasses.field(default_factory=FlatConfig)
    grey: GreyConfig = dataclasses.field(default_factory=GreyConfig)


@dataclasses.dataclass(frozen=True)
class Calibration:
    """What was measured.

    Attributes:
        flats: camera id to its field; empty without flats and darks.
        colours: camera id to its correction; empty without a chart.
        fits: camera id to the fit that gave it.
        full_levels: (n,) what the chart was lit by; None without a chart.
        facts: JSON-ready, by part.
        warnings: what to tell.
    """

    flats: dict[str, FlatField]
    colours: dict[str, ColourCorrection]
    fits: dict[str, ColourFit]
    full_levels: np.ndarray | None
    facts: dict[str, Any]
    warnings: list[str]


def calibrate(
    source: Source, config: CalibrateConfig, progress: ProgressCallback = quiet
) -> Calibration:
    """Measure all that the photographs tell.

    Raises:
        ProcessingError: nothing to measure, or every camera whose photographs will not do, in one
            message.
    """
    poses = source.poses
    if not any(kind in poses for kind in ("chart", "flat", "dark")):
        raise ProcessingError(
            source.root,
            found=f"shots of {', '.join(poses)}",
            expected="shots of a chart, a flat card or the dark",
            hint="Take them: `lightstage calibrate chart --out LAB`.",
        )
    warnings = list(source.warnings)
    facts: dict[str, Any] = {}
    flats = _flats(poses, config.flat, facts, warnings)
    fits: dict[str, ColourFit] = {}
    colours: dict[str, ColourCorrection] = {}
    full = None
    if "chart" in poses:
        full = _levels(poses["chart"][0])
        lights = {pose.where: _lights(pose, full) for pose in poses["chart"]}
        fits, seen = fit_colours(
            poses["chart"], lights, flats, config.chart, config.colour, progress
        )
        colours = {name: fit.correction for name, fit in fits.items()}
        facts["colour"] = {name: fit.facts | _told(seen[name]) for name, fit in fits.items()}
        warnings += _colour_warnings(fits)
        if "grey" in poses:
            pose = poses["grey"][0]
            colours, facts["grey"] = check_grey(
                pose, colours, flats, _lights(pose, full), config.grey
            )
            if facts["grey"]["largest_error"] > 0.03:
                share = 100 * facts["grey"]["largest_error"]
                warnings.append(f"the grey ball reads {share:.1f} % away from its reflectance")
    else:
        warnings.append("no shots of the colour chart: no colours")
    return Calibration(flats, colours, fits, full, facts, warnings)


def write_calibration(
    found: Calibration, source: Source, config: CalibrateConfig, out: Path
) -> Path:
    """Write a calibration's folder: colour.json, flats.json, pictures, calibration.json.

    All of it appears at once; one that is there already is replaced.

    Returns:
        `out`.

    Raises:
        FormatError: `out` is something else.
    """
    resolved = dataclasses.asdict(config)
    with atomic_folder(out, NAME) as folder:
        if found.flats:
            write_flats(found.flats, folder / FLATS, {"source": source.facts})
        if found.colours and found.full_levels is not None:
            cameras = {
                name: _colour_entry(correction, found.fits[name])
                for name, correction in found.colours.items()
            }
            value = {"full_levels": found.full_levels.tolist(), "source": source.facts}
            write_json(folder / COLOUR, {"schema": COLOUR_SCHEMA, "cameras": cameras, **value})
            known = chart_reflectance(config.chart.reference)
            for name, fit in found.fits.items():
                write_swatches(fit, known, folder / f"chart-{name}.png")
        write_json(
            folder / NAME,
            {
                "schema": SCHEMA,
                "source": source.facts,
                "config": resolved,
                "facts": found.facts,
                "warnings": found.warnings,
                "versions": versions(),
            },
        )
    return out


def headline(found: Calibration) -> str:
    """The figures of a calibration on one line."""
    said = []
    if found.fits:
        facts = [fit.facts for fit in found.fits.values()]
        before = np.mean([each["delta_e"]["white_balance_alone"] for each in facts])
        after = np.mean([each["delta_e"]["mean"] for each in facts])
        bent = sum(each["used"] == "root_polynomial" for each in facts)
        said.append(
            f"colours of {len(facts)} cameras ({bent} by root-polynomial), Delta E 2000 "
            f"{before:.2f} by white balance alone, {after:.2f} now"
        )
    if "grey" in found.facts:
        said.append(f"grey ball within {100 * found.facts['grey']['largest_error']:.2f} %")
    if "flat" in found.facts:
        corners = [each["light_at_the_corner"] for each in found.facts["flat"].values()]
        said.append(f"flats of {len(corners)} cameras, corners at {100 * min(corners):.1f} %")
    if "dark" in found.facts:
        hot = sum(each["hot_pixels"] for each in found.facts["dark"].values())
        said.append(f"{hot} hot pixels in {len(found.facts['dark'])} cameras")
    return ", ".join(said)


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
                    fields[name], told = fit_flat(mosaics, camera, config, where)
                    if told["residual_rms"] > config.max_residual:
                        warnings.append(f"{where}: uneven by {100 * told['residual_rms']:.1f} %")
                else:
                    field = fields.get(name, FlatField.even(camera))
                    fields[name], told = read_darks(mosaics, field, config, where)
                    offset = max(abs(value) for value in told["black_offset"])
                    if offset > config.max_black_offset:
                        warnings.append(
                            f"{where}: black lies {100 * offset:.3f} % of white off what the "
                            "files say; it is corrected"
                        )
                facts.setdefault(kind, {})[name] = told
            except LightstageError as error:
                problems.append(error)
    if problems:
        raise one_error(problems)
    return fields


def _levels(pose: Pose) -> np.ndarray:
    """(n,) what a pose's first pattern was lit by."""
    return np.asarray(pose.session.levels(pose.patterns[0]), float)


def _lights(pose: Pose, full: np.ndarray) -> LightSet:
    """What shone on a pose, on the scale on which a white under `full` reads 1."""
    return stage_lights(pose.session.rig, _levels(pose), pose.where, full)


def _told(seen: Seen) -> dict[str, Any]:
    """Where a camera's chart comes from."""
    return {
        "pose": seen.pose.where,
        "tilt_deg": round(seen.tilt_deg, 2),
        "patches_fit_px": round(2 * seen.view.fit_px, 3),
        "exposure": seen.exposure,
    }


def _colour_warnings(fits: dict[str, ColourFit]) -> list[str]:
    """What of the fits to tell."""
    said = []
    for name, fit in fits.items():
        for why, patches in fit.facts["left_out"].items():
            if patches:
                numbers = ", ".join(str(patch) for patch in patches)
                said.append(f"chart, {name}: patches {numbers} left out, {why.replace('_', ' ')}")
        if fit.facts["delta_e"]["mean"] > 3:
            said.append(
                f"chart, {name}: Delta E {fit.facts['delta_e']['mean']:.1f} in the mean; is it the "
                "chart of the configuration?"
            )
    return said


def _colour_entry(correction: ColourCorrection, fit: ColourFit) -> dict[str, Any]:
    """One camera's entry in colour.json."""
    bent = correction.root_polynomial
    keys = ("used", "held_out_delta_e", "delta_e", "reflectance_rms", "neutral_scale")
    return {
        "linear_from_raw": correction.matrix.tolist(),
        "root_polynomial": None if bent is None else bent.tolist(),
        "exposure": correction.exposure,
        "facts": {key: fit.facts[key] for key in keys},
    }
