"""A calibration's folder: colour.json, flats.json, lights.json, pictures, calibration.json.

Its pictures show each camera's chart as it reads now, beside what it is.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.formats.colour import SCHEMA as COLOUR_SCHEMA
from lightstage.formats.files import atomic_folder, write_json
from lightstage.formats.flats import write_flats
from lightstage.formats.lights import write_measured_lights
from lightstage.formats.png import write_png
from processing.calibration.colour.chart import COLUMNS, ROWS
from processing.calibration.colour.chart_reference import chart_reflectance
from processing.calibration.colour.fit import ColourFit
from processing.calibration.config import CalibrateConfig
from processing.calibration.folder import RESULT, Source
from processing.calibration.stage import Calibration, calibrate
from processing.colour import ColourCorrection, srgb_from_linear
from processing.records import versions

SIDE, GAP = 96, 8
"""Side of a chart's patches in their picture, and the gap between them, pixels."""
NAME = "calibration.json"
COLOUR, FLATS, LIGHTS = "colour.json", "flats.json", "lights.json"
OWN = (NAME, COLOUR, FLATS, "flats-*.npz", LIGHTS, "chart-*.png")


def make_calibration(
    source: Source, config: CalibrateConfig, out: Path, progress: ProgressCallback = quiet
) -> Calibration:
    """Measure, and write colour.json, flats.json, lights.json, pictures and calibration.json.

    All of it appears at once; a calibration that is there already is replaced.

    Raises:
        FormatError: `out` is something else, or has files of others (refused before anything is
            measured).
        ProcessingError: see `stage.calibrate`.
    """
    # A folder of calibration shots has a file of this name, too.
    with atomic_folder(out, NAME, schema=RESULT, own=OWN) as folder:
        found = calibrate(source, config, progress)
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
        if found.lights is not None:
            write_measured_lights(*found.lights, folder / LIGHTS)
        write_json(
            folder / NAME,
            {
                "schema": RESULT,
                "source": source.facts,
                "config": dataclasses.asdict(config),
                "facts": found.facts,
                "warnings": found.warnings,
                "versions": versions(),
            },
        )
    return found


def headline(found: Calibration) -> str:
    """The figures of a calibration on one line."""
    parts = []
    if found.fits:
        facts = [fit.facts for fit in found.fits.values()]
        before = np.mean([each["delta_e"]["white_balance_alone"] for each in facts])
        after = np.mean([each["delta_e"]["mean"] for each in facts])
        bent = sum(each["used"] == "root_polynomial" for each in facts)
        parts.append(
            f"colours of {counted(len(facts), 'camera')} ({bent} by root-polynomial), Delta E 2000 "
            f"{before:.2f} by white balance alone, {after:.2f} now"
        )
    if "grey" in found.facts:
        parts.append(f"grey ball within {100 * found.facts['grey']['largest_error']:.2f} %")
    if "flat" in found.facts:
        corners = [each["light_at_the_corner"] for each in found.facts["flat"].values()]
        parts.append(
            f"flats of {counted(len(corners), 'camera')}, corners at {100 * min(corners):.1f} %"
        )
    if "dark" in found.facts:
        hot = sum(each["hot_pixels"] for each in found.facts["dark"].values())
        parts.append(
            f"{counted(hot, 'hot pixel')} in {counted(len(found.facts['dark']), 'camera')}"
        )
    if found.lights is not None:
        parts.append(counted(len(found.lights[1].lights), "lamp"))
    return ", ".join(parts)


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


def write_swatches(fit: ColourFit, known: np.ndarray, path: Path) -> Path:
    """Draw the 24 patches: as read, in each a square as it is, and the colour difference below.

    Args:
        fit: of a camera.
        known: (24, 3) reflectances.
        path: of a PNG.
    """
    pitch = SIDE + GAP
    picture = np.full((ROWS * pitch + GAP, COLUMNS * pitch + GAP, 3), 20, np.uint8)
    shown = np.rint(255 * srgb_from_linear(np.stack([fit.read, known]))).astype(np.uint8)
    for index in range(ROWS * COLUMNS):
        row, column = divmod(index, COLUMNS)
        top, left = GAP + row * pitch, GAP + column * pitch
        read, true = shown[:, index, ::-1]
        picture[top : top + SIDE, left : left + SIDE] = read
        inner = SIDE // 3
        picture[top + inner : top + 2 * inner, left + inner : left + 2 * inner] = true
        apart = fit.facts["patch_delta_e"][index]
        text = "" if apart is None else f"{apart:.2f}"
        if not fit.kept[index]:
            text += " left out"
        ink = (0, 0, 0) if known[index].mean() > 0.18 else (255, 255, 255)
        place = (left + 4, top + SIDE - 6)
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.38, ink, 1, cv2.LINE_AA)
    return write_png(path, picture[:, :, ::-1])
