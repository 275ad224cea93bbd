"""How wrong are colours before and after calibration, and when is a root-polynomial better?"""

from __future__ import annotations

import dataclasses
import itertools
import json
import tempfile
from pathlib import Path

import colour
import numpy as np

from benchmarks.record import record
from lightstage.commands import quiet
from lightstage.rig import default_rig
from processing.calibration.colour.config import ColourFitConfig
from processing.calibration.colour.fit import ChartSample, fit_colour
from processing.calibration.config import CalibrateConfig
from processing.calibration.folder import read_source
from processing.calibration.stage import calibrate
from processing.colour import ColourCorrection
from processing.colour_difference import delta_e_2000, lab_from_linear
from sim.camera.flaws import PRESETS
from sim.camera.optics import make_lens
from sim.skin.pigments import WAVELENGTHS_NM, reflectance
from sim.targets.target_session import TargetsConfig, write_targets

SEED, SCALE, CAMERAS = 3, 0.25, 3
SHAPE = colour.SpectralShape(400, 700, 10)
LEDS = ("LED-B3", "LED-B4", "LED-B5", "LED-V2", "LED-RGB1")
MELANIN, BLOOD = (0.01, 0.03, 0.08, 0.2, 0.4), (0.005, 0.02, 0.06)


def main() -> None:
    record(
        "Colour calibration on the simulated stage",
        (
            "flaws",
            "Delta E 2000 by white balance alone",
            "calibrated: mean, largest patch",
            "held out: matrix, root-polynomial",
            "reflectance RMSE",
            "largest entry of (matrix x truth - 1)",
            "grey ball of .18 reads",
            "light at the corner",
            "vignetting left, largest",
        ),
        [stage_row(name) for name in ("ideal", "lab", "bad")],
        f"`lightstage-sim targets` at {SCALE} of the rig's pixels, {CAMERAS} cameras, worst camera "
        "of each figure: chart toward each camera, grey ball, two flats, two darks, then all of "
        "`lightstage-processing calibrate`.",
    )
    record(
        "Colour calibration of measured cameras",
        (
            "camera",
            "LED",
            "white balance alone",
            "matrix, held out",
            "root-polynomial, held out",
            "the two of skin: matrix, root-polynomial",
            "used",
            "15 model skins: matrix",
            "root-polynomial",
        ),
        [row for name in colour.MSDS_CAMERA_SENSITIVITIES for row in camera_rows(name)],
        "Delta E 2000, mean. Spectra of sensors, CIE LEDs and the chart (ISO 17321-1) from "
        "colour-science; what is known is the chart under D65, so what the LEDs show otherwise "
        "counts as error. Skins are spectra of the simulator's two-layer model and were fitted to "
        "by nobody.",
    )


def stage_row(name: str) -> tuple[object, ...]:
    """A whole calibration of simulated targets against their truth."""
    flaws = PRESETS[name]
    rig = default_rig()
    rig = dataclasses.replace(rig, cameras=rig.cameras[:CAMERAS]).scaled(SCALE)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "T"
        write_targets(rig, out, TargetsConfig(board_poses=0), flaws, SEED, quiet)
        truth = json.loads((out.with_name("T.truth") / "targets.json").read_text())
        found = calibrate(read_source(out), CalibrateConfig())
    facts = found.facts["colour"]
    matrix = 0.0
    vignetting = 0.0
    for camera in rig.cameras:
        pose = facts[camera.id]["pose"].split(", ")[1]
        factor = truth["targets"][pose]["exposure_factor"]
        product = found.colours[camera.id].matrix @ truth["sensors"][camera.id]["raw_from_linear"]
        matrix = max(matrix, np.abs(product * factor - np.eye(3)).max())
        shading = make_lens(camera, flaws.lens, SEED).shading
        off = found.flats[camera.id].gain(shading.shape) * shading - 1
        vignetting = max(vignetting, float(np.abs(off).max()))

    def worst(*keys: str) -> float:
        values = []
        for each in facts.values():
            value = each
            for key in keys:
                value = value[key]
            values.append(value)
        return max(values)

    held = [worst("held_out_delta_e", kind, "all") for kind in ("matrix", "root_polynomial")]
    albedo = [each["albedo"] for each in found.facts["grey"]["cameras"].values()]
    corner = min(each["light_at_the_corner"] for each in found.facts["flat"].values())
    return (
        name,
        f"{worst('delta_e', 'white_balance_alone'):.2f}",
        f"{worst('delta_e', 'mean'):.3f}, {worst('delta_e', 'largest'):.3f}",
        f"{held[0]:.3f}, {held[1]:.3f}",
        f"{worst('reflectance_rms'):.5f}",
        f"{matrix:.4f}",
        f"{np.min(albedo):.4f} to {np.max(albedo):.4f}",
        f"{corner:.3f}",
        f"{100 * vignetting:.3f} %",
    )


def camera_rows(name: str) -> list[tuple[object, ...]]:
    """Fits of a measured camera under several LEDs, tried on skin."""
    known, chart = truth_of(chart_spectra()), chart_spectra()
    skins = skin_spectra()
    skin_known = truth_of(skins)
    rows: list[tuple[object, ...]] = []
    for led in LEDS:
        light = _values(colour.SDS_ILLUMINANTS[led])[:, None]
        sensor = _values(colour.MSDS_CAMERA_SENSITIVITIES[name]) * light
        sensor = sensor / sensor[:, 1].sum()
        sample = ChartSample(chart @ sensor, np.ones((24, 3)), np.zeros(24))
        fit = fit_colour([sample], known, ColourFitConfig())
        held = fit.facts["held_out_delta_e"]
        skin = [
            delta_e_2000(
                lab_from_linear(each.apply(skins @ sensor)), lab_from_linear(skin_known)
            ).mean()
            for each in (
                ColourCorrection(fit.matrix),
                ColourCorrection(fit.matrix, fit.root_polynomial),
            )
        ]
        rows.append(
            (
                name.split(" (")[0],
                led,
                f"{fit.facts['delta_e']['white_balance_alone']:.2f}",
                f"{held['matrix']['all']:.2f}",
                f"{held['root_polynomial']['all']:.2f}",
                f"{held['matrix']['skin']:.2f}, {held['root_polynomial']['skin']:.2f}",
                fit.facts["used"].replace("_", "-"),
                f"{skin[0]:.2f}",
                f"{skin[1]:.2f}",
            )
        )
    return rows


def chart_spectra() -> np.ndarray:
    """(24, 31) reflectances."""
    return np.array([_values(sd) for sd in colour.SDS_COLOURCHECKERS["ISO 17321-1"].values()])


def skin_spectra() -> np.ndarray:
    """(15, 31) reflectances of skin from light to dark, with little to much blood."""
    grid = np.array(list(itertools.product(MELANIN, BLOOD)))
    inside = np.isin(WAVELENGTHS_NM, SHAPE.wavelengths)
    return np.asarray(reflectance(grid[:, 0], grid[:, 1], 0.7)[:, inside])


def truth_of(spectra: np.ndarray) -> np.ndarray:
    """(n, 3) linear sRGB of reflectances under D65, white 1."""
    eye = _values(colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"])
    eye = eye * _values(colour.SDS_ILLUMINANTS["D65"])[:, None]
    xyz = spectra @ eye / eye[:, 1].sum()
    return np.asarray(colour.XYZ_to_RGB(xyz, "sRGB"))


def _values(spectra: colour.SpectralDistribution) -> np.ndarray:
    return np.asarray(spectra.copy().align(SHAPE).values)


if __name__ == "__main__":
    main()
