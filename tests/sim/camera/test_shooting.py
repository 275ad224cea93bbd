"""What reaches the sensors: lamps, room, pulses, sway and lens together."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.exr import read_exr
from lightstage.patterns import drive_levels, pattern_levels
from sim.camera.flaws import PRESETS, CaptureFlaws, LensConfig, PulseConfig, RoomConfig, SwayConfig
from sim.camera.shooting import Shooting, depth_picture
from sim.devices.photographer import Photographer
from sim.light.world import World
from sim.session import SessionConfig, flaws_path, write_direct

NEAR = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def world(ball, tiny_rig):
    return World(ball, tiny_rig)


def levels_of(world: World, *names: str) -> np.ndarray:
    return np.stack([pattern_levels(name, world.rig) for name in names])


def shoot(world: World, flaws: CaptureFlaws, *names: str, **more: float) -> np.ndarray:
    shooting = Shooting(world, flaws, 1)
    return shooting.light("cam0", levels_of(world, *names), range(len(names)), **more)


def test_without_flaws_the_light_is_the_worlds(world):
    levels = levels_of(world, "full", "x+")
    np.testing.assert_array_equal(
        shoot(world, CaptureFlaws(), "full", "x+"), world.photograph("cam0", levels)
    )


@pytest.mark.parametrize("name", ["ideal", "lab", "bad"])
@pytest.mark.parametrize("axis", "xyz")
def test_a_pair_of_gradients_sums_to_full_before_the_sensor(world, name, axis):
    """With every flaw of the lens; a room's light stands in all three and is taken off first."""
    flaws = dataclasses.replace(PRESETS[name], sway=SwayConfig())
    names = ("full", f"{axis}+", f"{axis}-", "dark")
    full, plus, minus, dark = shoot(world, flaws, *names)
    np.testing.assert_allclose(plus + minus - dark, full, atol=1e-5 * full.max())


def test_room_light_is_there_when_the_lamps_are_dark_and_has_its_colour(world):
    room = RoomConfig(ambient=0.1, ambient_rgb=(1.0, 0.8, 0.5))
    dark, full = shoot(world, CaptureFlaws(room=room), "dark", "full")
    surface = world.surfaces["cam0"]
    mask = surface.picture(surface.view @ NEAR.astype(np.float32)) > 0.8
    mask &= surface.picture(surface.normal[:, 2]) > 0.8
    albedo = surface.picture(surface.albedo)
    # The ball hides nothing: each place reads its albedo's share, and a mirror's few per cent.
    ratio = dark[mask] / (0.1 * albedo[mask] * np.array([1.0, 0.8, 0.5]))
    assert 0.9 < np.median(ratio) < 1.2
    bare = shoot(world, CaptureFlaws(), "full")[0]
    np.testing.assert_allclose(full - dark, bare, atol=1e-5 * bare.max())


def test_pulses_band_a_dimmed_pattern_and_not_one_that_is_fully_on(world):
    pulses = CaptureFlaws(pulses=PulseConfig(frequency_hz=130.0))
    names = ("lin-x+", "full")
    steady = shoot(world, CaptureFlaws(), *names)
    banded = shoot(world, pulses, *names, exposure_s=0.02)
    lit = steady[0].max(axis=2) > 0.1 * steady[0].max()
    ratio = np.where(lit, banded[0, ..., 1] / np.maximum(steady[0, ..., 1], 1e-9), np.nan)
    rows = np.nanmean(np.where(lit, ratio, np.nan)[lit.any(axis=1)], axis=1)
    assert np.ptp(rows) > 0.1
    np.testing.assert_allclose(banded[1], steady[1], rtol=1e-5, atol=1e-7)
    whole = shoot(world, pulses, *names, exposure_s=3 / 130.0)
    np.testing.assert_allclose(whole, steady, rtol=1e-5, atol=1e-7)
    unshuttered = shoot(world, pulses, *names)
    np.testing.assert_array_equal(unshuttered, steady)


def test_banded_light_is_each_lamps_own_light_times_its_own_bands(world):
    """The plain twin photographs every lamp by itself."""
    from sim.camera.pulses import band_gain

    flaws = CaptureFlaws(pulses=PulseConfig(frequency_hz=130.0))
    shooting = Shooting(world, flaws, 4)
    level = pattern_levels("lin-y+", world.rig)
    found = shooting.light("cam0", level[None], [2], 0.01)[0]
    camera = world.rig.camera("cam0")
    known = np.zeros_like(found)
    for k, value in enumerate(level):
        alone = np.zeros((1, len(level)))
        alone[0, k] = value
        gain = band_gain(value, camera.height_px, 0.01, shooting.phase("cam0", 2), flaws.pulses)
        known += world.photograph("cam0", alone)[0] * gain[:, None, None]
    np.testing.assert_allclose(found, known, rtol=1e-4, atol=1e-6 * known.max())


def test_depth_is_along_the_cameras_axis(world):
    depth = depth_picture(world.surfaces["cam1"])
    camera = world.rig.camera("cam1")
    assert depth[depth > 0].min() == pytest.approx(1100 - 80, abs=0.5)
    origin, rays = camera.pixel_rays()
    position = world.surfaces["cam1"].picture(world.surfaces["cam1"].position)
    axis = camera.cam_from_world[2, :3]
    seen = depth > 0
    known = np.linalg.norm(position[seen] - origin, axis=1) * (rays[seen] @ axis)
    np.testing.assert_allclose(depth[seen], known, rtol=1e-5)


def test_pixels_that_show_a_part_of_the_edge_blur_with_it(ball, tiny_rig):
    """Nine rays a pixel at silhouettes: no sharp rim is left around a blurred ball."""
    fine = World(ball, tiny_rig, samples=3)
    flaws = CaptureFlaws(
        lens=LensConfig(f_number=0.7, depth_of_field=True, focus_before_origin_mm=-400.0)
    )
    sharp, blurred = (shoot(fine, f, "full")[0, ..., 1] for f in (CaptureFlaws(), flaws))
    partly = (depth_picture(fine.surfaces["cam0"]) == 0) & (sharp > 0)
    assert partly.sum() > 20
    radius = Shooting(fine, flaws, 1).lenses["cam0"].circle_px(np.array([1095.0]))[0]
    assert radius > 1.0
    np.testing.assert_allclose(blurred.sum(), sharp.sum(), rtol=1e-3)
    assert np.abs(np.diff(blurred, axis=1)).max() < 0.6 * np.abs(np.diff(sharp, axis=1)).max()


def test_a_swaying_subjects_first_photograph_is_where_its_truth_is(world):
    flaws = CaptureFlaws(sway=SwayConfig(sway_mm=8.0, sway_deg=3.0))
    shooting = Shooting(world, flaws, 5)
    levels = levels_of(world, "full", "full")
    first, second = shooting.light("cam0", levels, [0, 1])
    np.testing.assert_array_equal(first, world.photograph("cam0", levels[:1])[0])
    assert np.abs(second - first).max() > 0.1 * first.max()
    # The silhouette's middle goes where the recorded pose takes the ball's centre.
    pose = shooting.pose(1)
    expected, _ = world.rig.camera("cam0").project(np.stack([pose[:, 3], np.zeros(3)]))
    places = [np.argwhere(p.max(axis=2) > 0).mean(axis=0)[::-1] for p in (second, first)]
    np.testing.assert_allclose(places[0] - places[1], expected[0] - expected[1], atol=0.25)


def test_a_direct_session_with_flaws_states_what_was_done(world, tmp_path):
    lens = LensConfig(vignetting=0.3, blur_um=300.0)
    sway = SwayConfig(sway_mm=3.0)
    flaws = CaptureFlaws(lens=lens, sway=sway, room=RoomConfig(ambient=0.02))
    out = tmp_path / "s"
    write_direct(world, out, SessionConfig(sequence="full,x+"), 6, quiet, flaws)
    record = json.loads(flaws_path(out).read_text())
    assert record["schema"] == "lightstage.sim-flaws/1"
    assert record["flaws"] == json.loads(json.dumps(dataclasses.asdict(flaws)))
    shooting = Shooting(world, flaws, 6)
    photographs = record["photographs"]
    np.testing.assert_array_equal(photographs["full"]["world_from_first"], np.eye(4)[:3])
    np.testing.assert_allclose(photographs["x+"]["world_from_first"], shooting.pose(1))
    assert record["lenses"]["cam1"]["corner_loss"] == pytest.approx(0.3)
    known = shooting.light("cam1", levels_of(world, "x+"), [1])[0]
    np.testing.assert_allclose(read_exr(out / "frames/x+/cam1.exr"), known, rtol=1e-3, atol=1e-6)


def test_a_photographer_with_flaws_repeats_itself_and_states_its_sensors(world):
    flaws = dataclasses.replace(
        PRESETS["bad"], sensor=dataclasses.replace(PRESETS["bad"].sensor, headroom=0.8)
    )
    camera = world.rig.camera("cam0")
    first, again = (Photographer(world, 1, flaws, ("full", "lin-x+")) for _ in range(2))
    level = drive_levels("lin-x+", world.rig)
    assert first.photograph(camera, level) == again.photograph(camera, level)
    assert first.photograph(camera, level) != Photographer(world, 1).photograph(camera, level)
    record = first.record(("full", "lin-x+"))
    assert record["photographs"]["lin-x+"]["shot"] == 1
    assert set(record["photographs"]["lin-x+"]["pulse_phase"]) == {"cam0", "cam1"}
    sensor = record["sensors"]["cam0"]
    assert sensor["iso"] == 3200
    assert sensor["electrons_per_dn"] == pytest.approx(5 / 32)
    assert sensor["exposure_s"] == first.sensors["cam0"].exposure_s
