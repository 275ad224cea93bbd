"""Lights measured from balls: where lamps are, what they shine, and the gain by measuring them.

Run `python -m benchmarks.lights`. The simulator's lamps stand 5 mm from where the rig has them and
shine unevenly; a mirror ball and a grey ball are photographed in its own light with pixel noise,
and lights are fitted. What counts is another ball, as large as a head: the error of its normals by
ratios as they are, by ratios corrected on the grey ball, by the rig's nominal lamps and by measured
ones.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.record import record
from lightstage.formats.lights import MeasuredLights
from lightstage.patterns import SEQUENCES, pattern_levels
from lightstage.rig import Camera, Rig, default_rig
from processing.calibration.ball import BallShots, Picture
from processing.calibration.lights.fit import fit_lights
from processing.calibration.lights.grey_ball import Readings
from processing.calibration.lights.ratios import (
    corrected,
    errors_deg,
    fit_ratios,
    lamp_normals,
    ratio_vectors,
)
from processing.lighting.lamps import NO_STRAY, Lamps, measured_rig, nominal_lamps
from processing.lighting.lights import lights_of
from processing.vectors import unit
from sim.light.lamps import LampConfig, lamps_of
from sim.light.lamps import Lamps as TrueLamps
from sim.targets.ball import Ball, photograph_grey, photograph_mirror
from sim.targets.light import white_reading

PATTERNS = SEQUENCES["binary"]
SMALL_MM, HEAD_MM = 38.1, 95.0
SCALE = 0.25
NOISE = 1e-3
MOVED_MM = 5.0
FRONT = 0.2
"""Cosine to a camera in front of the steepest place of a ball that counts."""
CLOSE = ((0.0, 0.0, 0.0), (35.0, -20.0, 25.0))
APART = ((-70.0, -80.0, 0.0), (70.0, 80.0, 20.0))


def take(
    rig: Rig,
    lamps: TrueLamps,
    kind: str,
    place_mm: tuple[float, float, float],
    patterns: tuple[str, ...],
) -> BallShots:
    """Photographs of a ball in the simulator's light, with noise, exposed alike by all cameras."""
    mirror = kind == "mirror"
    ball = Ball(np.array(place_mm), SMALL_MM, 0.6 if mirror else 0.18)
    photograph = photograph_mirror if mirror else photograph_grey
    levels = {name: pattern_levels(name, rig) for name in patterns}

    def light(name: str, camera: Camera) -> np.ndarray:
        return photograph(ball, camera, lamps, levels[name], np.zeros(3))[0]

    brightest = 1.2 * float(light(patterns[0], rig.cameras[0]).max())

    def read(name: str, camera_id: str) -> Picture:
        camera = rig.camera(camera_id)
        rng = np.random.default_rng([list(levels).index(name), rig.cameras.index(camera)])
        shown = light(name, camera) / brightest
        shown += NOISE * np.sqrt(0.25 + shown) * rng.standard_normal(shown.shape, np.float32)
        return Picture(shown, np.asarray((shown < 1).all(axis=2)), camera)

    return BallShots(Path(kind), levels, tuple(c.id for c in rig.cameras), read)


def lit_ball(rig: Rig, lamps: TrueLamps, radius_mm: float, count: int = 4000) -> Readings:
    """A white ball at the centre as a camera in front sees it, read without noise."""
    rng = np.random.default_rng(7)
    normals = unit(rng.normal(size=(count, 3)))
    normals = normals[normals[:, 2] > FRONT]
    levels = np.stack([pattern_levels(name, rig) for name in PATTERNS])
    points = radius_mm * normals
    rgb = np.stack([white_reading(points, normals, lamps, each) for each in levels], axis=1)
    return Readings(PATTERNS, levels, points, normals, rgb, np.zeros(len(points), int))


def lamp_error(ball: Readings, lamps: Lamps) -> float:
    """Mean error in degrees of a ball's normals by lamps."""
    found = lamp_normals(ball, lights_of(lamps, ball.patterns, ball.levels))
    return float(errors_deg(found, ball.normals).mean())


def ratio_errors(small: Readings, head: Readings) -> tuple[float, float, float]:
    """Mean error in degrees on one ball: plain; affine and quadratic, fitted on another."""
    learned, ratios = ratio_vectors(small), ratio_vectors(head)
    fits = [fit_ratios(learned, small.normals, degree) for degree in (1, 2)]
    found = [unit(ratios), *(corrected(ratios, fit) for fit in fits)]
    plain, affine, quadratic = (float(errors_deg(n, head.normals).mean()) for n in found)
    return plain, affine, quadratic


def as_lamps(measured: MeasuredLights) -> Lamps:
    """Measured lights, up to one scale."""
    weights = 1e6 / np.sum(measured.position_mm**2, axis=1)[:, None] * measured.rgb_gain
    return Lamps(measured.position_mm, weights, measured.exponent, measured.stray, "measured")


def pattern_error(ball: Readings, lamps: Lamps) -> float:
    """Error of a pattern's light on a ball, root mean square, in per cent of full's mean."""
    one = lights_of(lamps, ball.patterns, ball.levels)
    way = one.position_mm - ball.points_mm[:, None]
    far = np.linalg.norm(way, axis=2)
    facing = np.maximum(np.einsum("nlk,nk->nl", way, ball.normals), 0) / far
    aside = np.einsum("nlk,lk->nl", way, one.position_mm) / (far * one.radius_mm)
    light = facing * (one.radius_mm / far) ** 2 * np.maximum(aside, 0) ** one.exponent
    found = light @ one.strength.T
    known = ball.rgb.mean(axis=2)
    found *= (found * known).sum() / (found**2).sum()
    return float(100 * np.sqrt(np.mean((found - known) ** 2)) / known[:, 0].mean())


def case(spread: float, places: tuple[tuple[float, float, float], ...], grey: bool) -> list[object]:
    """One row: a stage of lamps with this spread of gains, and the shots that were taken of it."""
    rig = default_rig().scaled(SCALE)
    rng = np.random.default_rng(11)
    moved = rig.positions_mm + rng.normal(size=(len(rig.lights), 3)) * MOVED_MM
    true = measured_rig(rig, moved, rig.rgb_gains)
    lamps = lamps_of(true, LampConfig(gain_spread=spread, colour_spread=0.02), seed=5)
    begun = time.perf_counter()
    measured = fit_lights(
        rig,
        [take(rig, lamps, "mirror", place, ("full",)) for place in places],
        [take(rig, lamps, "grey", (0.0, 0.0, 0.0), PATTERNS)] if grey else [],
    )
    seconds = time.perf_counter() - begun
    small, head = lit_ball(rig, lamps, SMALL_MM), lit_ball(rig, lamps, HEAD_MM)
    off = measured.position_mm - moved
    along = np.sum(off * moved, axis=1) / np.linalg.norm(moved, axis=1)
    across = np.sqrt(np.mean(np.maximum(np.sum(off**2, axis=1) - along**2, 0)))
    gains = lamps.weights / lamps_of(true, LampConfig()).weights
    wrong = np.log(measured.rgb_gain / gains)
    shots = "; ".join(
        [f"mirror ball, {len(places)} places {_apart(places):.0f} mm apart"] * bool(places)
        + ["grey ball"] * grey
    )
    residual = measured.facts.get("mirror", {}).get("residual_px", "-")
    own = as_lamps(measured)
    degrees = (
        *ratio_errors(small, head),
        lamp_error(head, nominal_lamps(rig)),
        lamp_error(head, own),
    )
    light = pattern_error(head, nominal_lamps(rig)), pattern_error(head, own)
    return [
        f"{100 * spread:.0f} %",
        shots,
        residual,
        f"{across:.1f}, {np.sqrt(np.mean(along**2)):.1f}",
        f"{100 * np.std(wrong - wrong.mean(axis=0)):.1f}",
        *(f"{value:.2f}" for value in degrees),
        f"{light[0]:.2f} to {light[1]:.2f}",
        f"{seconds:.0f}",
    ]


def _apart(places: tuple[tuple[float, float, float], ...]) -> float:
    return float(np.linalg.norm(np.subtract(places[0], places[-1]))) if places else 0.0


def main() -> None:
    """Measure and record."""
    rig = default_rig()
    lamps = TrueLamps(
        rig.positions_mm, nominal_lamps(rig).rgb, np.zeros((len(rig.lights), 3)), 0.0, 0.0
    )
    ideal = lit_ball(rig, lamps, 1e-3)
    plain, affine, quadratic = ratio_errors(ideal, ideal)
    exact = lamp_error(ideal, Lamps(rig.positions_mm, lamps.weights, 0.0, NO_STRAY, "nominal"))
    cells = [f"{value:.2f}" for value in (plain, affine, quadratic, exact)]
    rows: list[list[object]] = [
        ["0 %", "none: a small ball, the rig's lamps", "-", "-", "-", *cells, "-", "-", "-"]
    ]
    rows += [
        case(0.05, (), True),
        case(0.05, CLOSE, False),
        case(0.05, CLOSE, True),
        case(0.05, APART, True),
        case(0.15, CLOSE, True),
    ]
    record(
        "Lights from a mirror ball and a grey ball",
        (
            "gain spread",
            "shots",
            "highlights' residual, px",
            "lamps' places off across, along, mm",
            "gains off, %",
            "plain ratios, deg",
            "affine, deg",
            "quadratic, deg",
            "nominal lamps, deg",
            "measured lamps, deg",
            "light of a pattern off, nominal to measured, %",
            "s",
        ),
        rows,
        "Degrees: mean error of normals on a matt ball, in the first row a tiny one, below one of "
        "95 mm radius, seen from the front, rim left out; corrections are fitted on a ball of 38 "
        "mm. Nine cameras of 1.5 MP, noise .001 sqrt(.25 + I), 168 lamps 5 mm off per axis (8.7 "
        "mm), bare LEDs (cosine), every light on at once for the mirror ball. Seconds are mostly "
        "the simulator's.",
    )


if __name__ == "__main__":
    main()
