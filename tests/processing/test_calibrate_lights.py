"""Lights measured from the simulator's balls, whose lamps are known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.files import sha256_file, write_bytes
from lightstage.formats.lights import read_measured_lights, write_measured_lights
from lightstage.formats.session import Frame, Session, SessionFile
from lightstage.patterns import SEQUENCES, pattern_levels
from lightstage.patterns.names import BINARY, LINEAR
from lightstage.rig import Camera, Rig, default_rig
from processing.calibration.ball import Picture, ball_shots, find_ball, rays_through
from processing.calibration.lights.config import GreyBallConfig, LightsConfig, MirrorBallConfig
from processing.calibration.lights.fit import fit_lights, normal_errors
from processing.calibration.lights.flux import Flux, intensities
from processing.calibration.lights.grey_ball import (
    Readings,
    expected_gains,
    lamp_readings,
    nominal_weights,
    solve_gains,
)
from processing.calibration.lights.highlights import expected_px, find_highlights, mirrored
from processing.calibration.lights.mirror_ball import solve_lamps
from processing.errors import ProcessingError
from processing.lighting.lamps import nominal_lamps
from sim.devices.target_photographer import TargetPhotographer
from sim.light.lamps import LampConfig, lamps_of
from sim.targets.ball import Ball, highlights_mm, photograph_mirror
from tests.processing.balls_in_stage import RADIUS_MM, displaced, sightings, small_rig, take

PATTERNS = ("full", *BINARY)
RIG = default_rig()
COUNT = len(RIG.lights)
UNKNOWN = np.full((COUNT, 3), np.nan), np.full(COUNT, np.inf)
FEW = LightsConfig(grey=GreyBallConfig(places=150))


def apart_mm(found: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(L,) errors across and along the way from the origin."""
    off = found - known
    along = np.abs(np.sum(off * known, axis=1) / np.linalg.norm(known, axis=1))
    return np.sqrt(np.maximum(np.sum(off * off, axis=1) - along**2, 0)), along


def readings_of(rig: Rig, gains: np.ndarray, count: int = 300, exponent: float = 1.0) -> Readings:
    """A grey ball at the origin, read without noise; the plain sum over lamps."""
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    levels = np.stack([pattern_levels(name, rig) for name in PATTERNS])
    points = normals * RADIUS_MM
    light, _ = lamp_readings(points, normals, rig.positions_mm, exponent)
    weights = nominal_weights(rig.positions_mm)[:, None] * gains
    rgb = np.einsum("nl,pl,lc->npc", light, levels, weights)
    group = np.arange(count) % 2
    rgb *= np.array([0.7, 3.0])[group][:, None, None]
    return Readings(PATTERNS, levels, points, normals, rgb, group)


def test_lamps_are_found_where_the_simulators_highlights_put_them() -> None:
    rig = small_rig(9, 0.5)
    true = displaced(rig, 8.0)
    balls = [Ball(np.array(p), 38.0, 0.6) for p in ((-100.0, 3.0, 0.0), (90.0, -30.0, 20.0))]
    seen = [s for k, b in enumerate(balls) for s in sightings(rig, true.positions_mm, b, k, 0.1)]
    placed = solve_lamps(seen, rig.positions_mm, MirrorBallConfig(), "here")
    across, along = apart_mm(placed.position_mm, true.positions_mm)
    assert np.sqrt(np.mean(across**2)) < 0.6
    assert np.sqrt(np.mean(along**2)) < 4.0
    assert np.mean(along < 3 * placed.sigma_mm) > 0.97
    np.testing.assert_allclose(placed.centres_mm, [b.centre_mm for b in balls], atol=0.05)
    assert placed.radius_mm == pytest.approx(38.0, abs=0.02)
    assert placed.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.15)


def test_highlights_of_no_lamp_do_not_move_the_lamps() -> None:
    rig = small_rig(5, 0.5)
    true = displaced(rig, 5.0)
    rng = np.random.default_rng(0)
    seen = []
    for pose, place in enumerate(((-60.0, 0.0, 0.0), (60.0, 20.0, -20.0))):
        for each in sightings(rig, true.positions_mm, Ball(np.array(place), 38.1, 0.6), pose, 0.05):
            px = each.found.place_px.copy()
            wrong = rng.random(len(px)) < 0.08
            px[wrong] += rng.normal(size=(wrong.sum(), 2)) * 6
            seen.append(
                dataclasses.replace(each, found=dataclasses.replace(each.found, place_px=px))
            )
    placed = solve_lamps(seen, rig.positions_mm, MirrorBallConfig(), "here")
    across, _ = apart_mm(placed.position_mm, true.positions_mm)
    assert np.quantile(across, 0.95) < 1.5


def test_a_ball_of_another_size_and_an_empty_stage_are_reported() -> None:
    rig = small_rig(5, 0.3)
    ball = Ball(np.zeros(3), 50.0, 0.6)
    seen = sightings(rig, rig.positions_mm, ball, 0, 0.02)
    with pytest.raises(ProcessingError, match=r"radius|highlights? at the rig"):
        solve_lamps(seen, rig.positions_mm, MirrorBallConfig(radius_sigma_mm=20.0), "here")
    with pytest.raises(ProcessingError, match="0 highlights in 0 cameras"):
        solve_lamps([_without(s) for s in seen], rig.positions_mm, MirrorBallConfig(), "here")


def _without(seen):  # type: ignore[no-untyped-def]
    none = dataclasses.replace(
        seen.found, place_px=seen.found.place_px[:0], flux=seen.found.flux[:0]
    )
    return dataclasses.replace(seen, found=none, lamp=seen.lamp[:0], toward=seen.toward[:0])


def test_highlights_are_expected_where_the_simulator_has_them_and_lead_back_to_the_lamp() -> None:
    rig = small_rig(3, 0.5)
    bent = dataclasses.replace(rig.cameras[1], dist=(-0.2, 0.1, 0.002, -0.001, 0.0))
    ball = Ball(np.array([20.0, -30.0, 10.0]), 38.1, 0.6)
    known = bent.project(highlights_mm(ball, bent, rig.positions_mm))[0]
    found = expected_px(bent, ball.centre_mm, 38.1, rig.positions_mm)
    np.testing.assert_allclose(found, known, atol=1e-6)
    leaving = mirrored(ball.centre_mm, 38.1, bent.centre_mm, rays_through(bent, found))
    way = rig.positions_mm - leaving.points_mm
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    assert leaving.hit.all()
    np.testing.assert_allclose(leaving.directions, way, atol=1e-7)


def cropped(camera: Camera, side: int) -> Camera:
    """The middle of a camera's picture."""
    return dataclasses.replace(
        camera,
        width_px=side,
        height_px=side,
        cx_px=camera.cx_px - (camera.width_px - side) // 2,
        cy_px=camera.cy_px - (camera.height_px - side) // 2,
    )


def test_highlights_of_a_picture_lie_where_optics_has_them_and_are_alike_in_light() -> None:
    camera = cropped(default_rig().scaled(0.5).cameras[0], 660)
    ball = Ball(np.array([4.0, -2.0, 3.0]), RADIUS_MM, 0.6)
    some = np.arange(0, COUNT, 5)
    lamps = lamps_of(RIG, LampConfig(exponent=0.0))
    levels = np.zeros(COUNT)
    levels[some] = 1
    light, _ = photograph_mirror(ball, camera, lamps, levels, np.zeros(3))
    whole: np.ndarray = np.ones(light.shape[:2], dtype=bool)
    picture = Picture(light / light.max(), whole, camera)
    found = find_highlights(picture, 4.0, 0.04, 8.0)
    known = camera.project(highlights_mm(ball, camera, RIG.positions_mm[some]))[0]
    far = np.linalg.norm(found.place_px[:, None] - known[None], axis=2).min(axis=1)
    assert len(found.place_px) > 0.8 * len(some)
    assert np.quantile(far, 0.9) < 0.1
    # A mirror ball sends each lamp's light into all directions alike.
    flux = found.flux[:, 1]
    assert np.std(np.log(flux[flux > 0])) < 0.15


@settings(max_examples=25)
@given(
    st.sampled_from([0.0, -1.0, np.nan, np.inf, 1e-6, 1e6]),
    st.floats(0, 1),
    st.integers(0, 1000),
)
def test_pictures_of_anything_give_finite_highlights_or_none(
    odd: float, share: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rgb = rng.random((40, 50, 3)).astype(np.float32)
    where = rng.random((40, 50)) < share
    rgb[where] = odd
    valid = np.asarray(np.isfinite(rgb).all(axis=2))
    found = find_highlights(Picture(rgb, valid, RIG.cameras[0]), 3.0, 0.05, 5.0)
    assert np.isfinite(found.place_px).all()
    assert len(found.flux) == len(found.place_px)


def test_lamps_seen_once_each_are_not_known_however_well_they_fit_themselves() -> None:
    rng = np.random.default_rng(3)
    lamp, group = np.arange(60), np.repeat(np.arange(4), 15)
    light = np.exp(0.6 * rng.normal(size=(60, 3)))
    log, sigma = intensities(Flux(lamp, group, light), 80)
    assert np.isnan(log).all()
    assert np.isinf(sigma).all()


@pytest.mark.parametrize("noise", [0.003, 0.05, 0.5])
def test_the_error_of_an_intensity_is_reported_where_few_lamps_are_seen_twice(noise: float) -> None:
    rng = np.random.default_rng(4)
    lamp = np.concatenate([np.arange(100), np.arange(40)])
    group = rng.integers(0, 5, 140)
    light = np.exp(noise * rng.normal(size=(140, 1)) + np.zeros((140, 3)))
    log, sigma = intensities(Flux(lamp, group, light), 100)
    off = np.abs(log - np.median(log, axis=0)).mean(axis=1) / sigma
    assert 0.35 < np.median(off) < 1.4


def test_highlights_that_err_much_say_nothing_of_how_unlike_lamps_are() -> None:
    config = GreyBallConfig()
    log = 0.6 * np.random.default_rng(5).normal(size=(168, 3))
    _, prior = expected_gains(log, np.full(168, 0.6), config)
    assert prior.max() <= config.gain_sigma
    # Where each is known to 1 %, the same spread is the lamps' own.
    found, _ = expected_gains(log, np.full(168, 0.01), config)
    assert np.abs(found - log).max() < 0.01


def test_intensities_come_out_of_highlights_of_unlike_photographs() -> None:
    rng = np.random.default_rng(2)
    gain = np.exp(0.2 * rng.normal(size=(30, 3)))
    lamp = np.tile(np.arange(30), 12)
    group = np.repeat(np.arange(12), 30)
    scale = np.exp(rng.normal(size=(12, 3)))
    light = gain[lamp] * scale[group] * np.exp(0.01 * rng.normal(size=(360, 3)))
    light[::17] *= 3.0
    light[5::23] = np.nan
    log, sigma = intensities(Flux(lamp, group, light), 31)
    known = np.log(gain) - np.median(np.log(gain), axis=0)
    np.testing.assert_allclose(log[:30], known, atol=0.025)
    assert np.isnan(log[30]).all()
    assert np.isinf(sigma[30])


def test_gains_make_the_light_of_each_pattern_right_though_lamps_cannot_be_distinguished() -> None:
    rng = np.random.default_rng(3)
    gain = np.exp(0.1 * rng.normal(size=(COUNT, 3)))
    readings = readings_of(RIG, gain)
    config = GreyBallConfig(gain_sigma=0.1, noise_share=1e-4)
    found = solve_gains(readings, RIG.positions_mm, *UNKNOWN, config)
    assert found.before > 0.005
    assert found.after < 2e-4
    assert np.std(np.log(found.rgb / gain)) < 0.9 * 0.1
    assert found.exponent == pytest.approx(config.exponent, abs=0.1)


def test_readings_that_no_lamps_explain_are_refused_without_an_overflow() -> None:
    readings = readings_of(RIG, np.ones((COUNT, 3)))
    rng = np.random.default_rng(11)
    noise = dataclasses.replace(readings, rgb=rng.lognormal(0, 4, readings.rgb.shape))
    wide = GreyBallConfig(gain_sigma=3.0, noise_share=1e-4)
    with np.errstate(all="raise", under="ignore"), pytest.raises(ProcessingError, match="lamps"):
        solve_gains(noise, RIG.positions_mm, *UNKNOWN, wide)
    empty = dataclasses.replace(readings, rgb=np.full(readings.rgb.shape, np.nan))
    with pytest.raises(ProcessingError, match="readings that the rig's lamps explain"):
        solve_gains(empty, RIG.positions_mm, *UNKNOWN, GreyBallConfig())


def test_lamps_that_differ_several_times_are_found_from_equal_ones() -> None:
    gain = np.exp(0.5 * np.random.default_rng(12).normal(size=(COUNT, 3)))
    config = GreyBallConfig(gain_sigma=0.5, noise_share=1e-4)
    found = solve_gains(readings_of(RIG, gain), RIG.positions_mm, *UNKNOWN, config)
    assert found.before > 0.05
    assert found.after < 1e-5


def test_gains_known_from_highlights_are_kept_and_made_better() -> None:
    rng = np.random.default_rng(4)
    gain = np.exp(0.1 * rng.normal(size=(COUNT, 3)))
    stated = np.log(gain) + 0.02 * rng.normal(size=gain.shape)
    readings = readings_of(RIG, gain)
    sigma = np.full(COUNT, 0.02)
    found = solve_gains(readings, RIG.positions_mm, stated, sigma, GreyBallConfig(noise_share=1e-4))
    error = np.log(found.rgb / gain)
    assert np.std(error - error.mean(axis=0)) < 0.019
    assert found.after < 3e-4


def test_stray_light_of_a_pattern_is_found_as_it_was_put_in() -> None:
    readings = readings_of(RIG, np.ones((COUNT, 3)), 600)
    rng = np.random.default_rng(6)
    bent = 0.01 * rng.normal(size=(3, 3, 4))
    bent[..., :3] += np.swapaxes(bent[..., :3], 1, 2).copy()
    n = readings.normals
    extra = np.einsum("ni,cij,nj->nc", n, bent[..., :3], n) + n @ bent[..., 3].T
    weights = nominal_weights(RIG.positions_mm)
    around = float(readings.levels[1] @ weights / 4)
    rgb = readings.rgb.copy()
    rgb[:, 1] += np.array([0.7, 3.0])[readings.group][:, None] * around * extra
    found = solve_gains(
        dataclasses.replace(readings, rgb=rgb),
        RIG.positions_mm,
        np.zeros((COUNT, 3)),
        np.full(COUNT, 1e-4),
        GreyBallConfig(highlight_sigma=1e-4, stray_share=0.1),
    )
    assert found.left < 0.4 * found.after
    back = np.einsum("ni,cij,nj->nc", n, found.stray["x+"][..., :3], n)
    back += n @ found.stray["x+"][..., 3].T
    # The camera's scale takes a little of what all patterns share.
    np.testing.assert_allclose(back, extra, atol=0.15 * np.abs(extra).max())


def test_a_grey_balls_outline_shows_where_it_is() -> None:
    rig = small_rig(3, 0.06)
    place = (7.0, -12.0, 20.0)
    shots = take(rig, lamps_of(rig), "grey", place, ("full",))
    pictures = [shots.read("full", camera.id) for camera in rig.cameras]
    found = find_ball(pictures, RADIUS_MM, Path("here"))
    np.testing.assert_allclose(found.centre_mm, place, atol=0.15)
    assert found.radius_mm == pytest.approx(RADIUS_MM, rel=0.01)
    dark = [dataclasses.replace(p, rgb=np.zeros_like(p.rgb)) for p in pictures]
    with pytest.raises(ProcessingError, match="0 of 3 cameras"):
        find_ball(dark, RADIUS_MM, Path("here"))
    with pytest.raises(ProcessingError, match="lit ball in 0"):
        find_ball(pictures, 4 * RADIUS_MM, Path("here"))


def test_raw_photographs_read_in_cells_show_the_ball_where_it_stands(tmp_path: Path) -> None:
    rig = small_rig(2, 0.08)
    photographer = TargetPhotographer(rig, "grey", 0)
    frames = []
    for camera in rig.cameras:
        data = photographer.photograph(camera, np.ones(COUNT))
        path = write_bytes(tmp_path / f"{camera.id}.dng", data)
        frames.append(
            Frame(
                pattern="full",
                camera=camera.id,
                path=path.name,
                sha256=sha256_file(path),
                encoding="raw",
            )
        )
    file = SessionFile(
        id="a",
        created_utc="2026-01-01T00:00:00+00:00",
        subject="none",
        expression="none",
        sequence=["full"],
        frames=frames,
    )
    shots = ball_shots(Session(tmp_path, file, rig))
    found = find_ball([shots.read("full", c.id) for c in rig.cameras], RADIUS_MM, tmp_path)
    np.testing.assert_allclose(found.centre_mm, 0, atol=0.3)
    assert found.radius_mm == pytest.approx(RADIUS_MM, rel=0.015)
    wrong = dataclasses.replace(rig, cameras=tuple(c.scaled(0.5) for c in rig.cameras))
    with pytest.raises(FormatError, match=r"in rig\.json"):
        ball_shots(Session(tmp_path, file, wrong)).read("full", rig.cameras[0].id)


def test_a_grey_balls_photographs_give_normals_ten_times_better_than_corrected_ratios() -> None:
    rig = small_rig(4, 0.05)
    lamps = lamps_of(rig, LampConfig(gain_spread=0.08), seed=3)
    shots = take(rig, lamps, "grey", (2.0, 0.0, -3.0), PATTERNS, room=0.02)
    found = fit_lights(rig, [], [shots], FEW)
    facts = found.facts["grey"]
    stated = facts["normals_deg"]
    assert stated["plain"] > 6
    assert stated["plain"] > stated["affine"] > stated["quadratic"]
    assert stated["measured"] < stated["quadratic"] / 10
    assert stated["measured"] < stated["nominal"]
    assert facts["error_measured_gains"] < 0.25 * facts["error_nominal_gains"]
    assert found.facts["lights"]["exponent_from"] == "assumed"
    assert np.isnan(found.residual_px).all()


def test_a_ball_moved_off_the_middle_tells_the_lamps_fall_off() -> None:
    rig = small_rig(3, 0.05)
    lamps = lamps_of(rig, LampConfig(exponent=2.5))
    places = ((20.0, 130.0, 0.0), (-30.0, -120.0, 40.0))
    shots = [take(rig, lamps, "grey", place, PATTERNS) for place in places]
    found = fit_lights(rig, [], shots, FEW)
    assert found.facts["lights"]["exponent_from"] == "grey ball"
    assert found.exponent == pytest.approx(2.5, abs=0.25)


def test_both_balls_give_where_lamps_stand_and_what_they_shine(tmp_path: Path) -> None:
    rig = small_rig(4, 0.12)
    true = displaced(rig, 6.0)
    lamps = lamps_of(true, LampConfig(gain_spread=0.1, radius_mm=25.0), seed=2)
    places = ((-60.0, 0.0, 0.0), (60.0, 20.0, -20.0))
    mirror = [take(rig, lamps, "mirror", place, ("full",)) for place in places]
    grey = [take(small_rig(3, 0.05), lamps, "grey", (0.0, 0.0, 0.0), PATTERNS)]
    found = fit_lights(rig, mirror, grey, FEW)
    across, _ = apart_mm(found.position_mm, true.positions_mm)
    moved, _ = apart_mm(rig.positions_mm, true.positions_mm)
    seen = np.isfinite(found.residual_px)
    assert seen.mean() > 0.8
    assert np.median(across[seen]) < 0.2 * np.median(moved)
    gains = lamps.weights / lamps_of(true, LampConfig()).weights
    error = np.log(found.rgb_gain / gains)[seen]
    assert np.std(error) < 0.6 * 0.1
    assert found.facts["grey"]["normals_deg"]["measured"] < 0.3
    again = read_measured_lights(write_measured_lights(found, rig, tmp_path / "l.json"), rig)
    np.testing.assert_array_equal(again.position_mm, found.position_mm)


def test_lights_photographed_one_by_one_are_known_by_their_pattern() -> None:
    rig = small_rig(3, 0.15)
    lights = (0, 40, 80, 81, 82, 100, 120, 140)
    patterns = ("full", *(f"olat-{k:03d}" for k in lights))
    lamps = lamps_of(displaced(rig, 6.0), LampConfig(radius_mm=25.0))
    shots = take(rig, lamps, "mirror", (0.0, 0.0, 0.0), patterns)
    found = fit_lights(rig, [shots], [])
    assert set(np.flatnonzero(np.isfinite(found.residual_px))) <= set(lights)
    assert found.facts["mirror"]["highlights"] >= 2 * len(lights)
    across, _ = apart_mm(found.position_mm, displaced(rig, 6.0).positions_mm)
    assert np.median(across[list(lights)]) < 1.5


def test_gradients_tell_whose_highlight_it_is_where_the_ball_stands_far_from_expected() -> None:
    rig = small_rig(3, 0.12)
    lamps = lamps_of(rig, LampConfig(radius_mm=25.0))
    shots = take(rig, lamps, "mirror", (0.0, 0.0, 0.0), ("full", *LINEAR))
    found = fit_lights(rig, [shots], [])
    across, _ = apart_mm(found.position_mm, rig.positions_mm)
    assert np.median(across) < 1.0
    assert found.facts["mirror"]["lights_not_seen"] < 0.2 * COUNT


def test_nothing_photographed_and_a_ball_of_another_radius_are_refused() -> None:
    with pytest.raises(ProcessingError, match="no shots of a mirror ball or a grey ball"):
        fit_lights(RIG, [], [])
    rig = small_rig(2, 0.05)
    shots = take(rig, lamps_of(rig), "grey", (0.0, 0.0, 0.0), ("full",), radius_mm=45.0)
    with pytest.raises(ProcessingError, match="a grey ball of 45"):
        fit_lights(rig, [], [shots], FEW)
    whole = take(rig, lamps_of(rig), "grey", (0.0, 0.0, 0.0), ("full",))

    def clipped(name: str, camera_id: str) -> Picture:
        picture = whole.read(name, camera_id)
        return dataclasses.replace(picture, valid=picture.rgb.mean(axis=2) < 0.3)

    with pytest.raises(ProcessingError, match="0 places of the grey ball"):
        fit_lights(rig, [], [dataclasses.replace(whole, read=clipped)], FEW)


def test_ratios_on_the_default_rig_are_as_wrong_as_known_and_lamps_are_not() -> None:
    """On what a camera in front sees of a small ball, its rim left out."""
    readings = readings_of(RIG, np.ones((COUNT, 3)), 4000, exponent=0.0)
    seen = readings.normals[:, 2] > 0.2
    readings = dataclasses.replace(
        readings,
        points_mm=0 * readings.points_mm[seen],
        normals=readings.normals[seen],
        group=readings.group[seen],
    )
    light, _ = lamp_readings(readings.points_mm, readings.normals, RIG.positions_mm, 0.0)
    weights = nominal_weights(RIG.positions_mm)
    rgb = np.repeat((light @ (readings.levels * weights).T)[:, :, None], 3, axis=2)
    found = normal_errors(dataclasses.replace(readings, rgb=rgb), {"lamps": nominal_lamps(RIG)})
    assert found["plain"] == pytest.approx(8.8, abs=0.5)
    assert found["affine"] == pytest.approx(3.4, abs=0.4)
    assert found["quadratic"] == pytest.approx(2.4, abs=0.4)
    assert found["lamps"] < 0.02


def test_binary_is_what_a_grey_balls_shots_hold() -> None:
    assert SEQUENCES["binary"] == PATTERNS
