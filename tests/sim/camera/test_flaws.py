"""Named flaws and their files; pulses, room light and sway by themselves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import ConfigError
from lightstage.rig import default_rig
from sim.camera.flaws import (
    PRESETS,
    CaptureFlaws,
    PulseConfig,
    SwayConfig,
    load_flaws,
    require_usable,
)
from sim.camera.pulses import band_gain
from sim.camera.room import even_levels
from sim.camera.sway import moved, poses
from sim.errors import SimError
from sim.light.lamps import lamps_of

PULSES = PulseConfig(frequency_hz=250.0, readout_ms=15.0)


def test_ideal_is_the_default_and_every_named_set_is_usable():
    assert load_flaws("ideal") == CaptureFlaws()
    for name, flaws in PRESETS.items():
        require_usable(flaws, name)


def test_a_file_overrides_what_it_names_and_keeps_the_rest(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('based_on = "lab"\n[sensor]\niso = 1600\n[room]\nambient = 1\n')
    flaws = load_flaws(str(path))
    assert flaws.sensor == dataclasses.replace(PRESETS["lab"].sensor, iso=1600)
    assert flaws.room == dataclasses.replace(PRESETS["lab"].room, ambient=1.0)
    assert flaws.lens == PRESETS["lab"].lens


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[lens]\nf_number = -1", "lens.f_number: found -1"),
        ("[lens]\nblur = 3", "blur: found an unknown key"),
        ("[sensor]\niso = 0", "sensor.iso: found 0"),
        ("[sensor]\nwhite_dn = 600", "sensor.white_dn: found 600"),
        ("[room]\nambient_rgb = [1, 1]", "room.ambient_rgb: found 2 values, expected 3"),
        ("[room]\nambient = nan", "room.ambient: found nan"),
        ("[room]\nambient_rgb = ['a', 1, 1]", "room.ambient_rgb[0]: found 'a', expected a number"),
        ('based_on = "worst"', "based_on: found 'worst'"),
        ("[lens", "expected valid TOML"),
    ],
)
def test_a_file_of_nonsense_is_refused_by_field(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises((SimError, ConfigError)) as caught:
        load_flaws(str(path))
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


def test_an_unknown_name_is_refused():
    with pytest.raises(SimError, match="ideal, lab, bad, or a TOML file"):
        load_flaws("worse")


def test_bands_vanish_when_the_exposure_is_a_whole_number_of_periods():
    for periods in (1, 3, 10):
        gain = band_gain(0.3, 400, periods / 250.0, 0.37, PULSES)
        np.testing.assert_allclose(gain, 1.0, atol=1e-9)
    assert np.ptp(band_gain(0.3, 400, 1.5 / 250.0, 0.37, PULSES)) > 0.5


def test_bands_have_the_period_of_the_pulses_on_the_shutter():
    """15 ms from first to last row, 250 pulses a second: 3.75 bands over the picture."""
    gain = band_gain(0.5, 1500, 2.4 / 250.0, 0.1, PULSES)
    np.testing.assert_allclose(gain[:1100], gain[400:], atol=1e-9)
    assert np.abs(gain[:1300] - gain[200:]).max() > 0.1


def test_the_mean_over_all_moments_is_the_level():
    gains = [band_gain(0.2, 50, 0.7 / 250.0, phase, PULSES) for phase in np.arange(0, 1, 1 / 1000)]
    np.testing.assert_allclose(np.mean(gains, axis=0), 1.0, rtol=2e-3)


def test_bands_are_the_share_of_sampled_moments_in_which_the_lamp_is_on():
    """The plain twin counts moments."""
    level, exposure_s, phase = 0.35, 0.0063, 0.6
    gain = band_gain(level, 40, exposure_s, phase, PULSES)
    moments = (np.arange(100_000) + 0.5) / 100_000 * exposure_s
    for row in range(40):
        seconds = row / 40 * 0.015 + moments
        on = (phase + seconds * 250.0) % 1 < level
        assert gain[row] == pytest.approx(on.mean() / level, abs=1e-3)


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 1), st.floats(1e-6, 10), st.floats(0, 1), st.floats(0, 1e5))
def test_band_gains_are_finite_and_bounded_by_a_lamp_that_is_always_on(level, seconds, phase, hz):
    gain = band_gain(level, 30, seconds, phase, PulseConfig(frequency_hz=hz))
    assert np.isfinite(gain).all()
    assert (gain >= -1e-6).all()
    assert (gain * level <= 1 + 1e-6).all()


def test_lamps_fully_on_or_off_or_dimmed_by_current_have_no_bands():
    for level, config in ((1.0, PULSES), (0.0, PULSES), (0.4, PulseConfig())):
        np.testing.assert_array_equal(band_gain(level, 9, 0.01, 0.2, config), 1.0)


def test_room_light_is_the_same_from_everywhere_though_the_lamps_crowd_the_poles():
    rig = default_rig()
    weights = even_levels(lamps_of(rig))[:, None] * lamps_of(rig).weights
    towards = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    normals = np.random.default_rng(1).standard_normal((200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    reading = np.maximum(normals @ towards.T, 0) @ weights
    np.testing.assert_allclose(reading, 1.0, rtol=0.03)


def test_dead_lamps_are_left_out_of_the_room():
    rig = default_rig()
    lights = tuple(
        dataclasses.replace(light, rgb_gain=(0.0, 0.0, 0.0)) if light.id < 20 else light
        for light in rig.lights
    )
    levels = even_levels(lamps_of(dataclasses.replace(rig, lights=lights)))
    assert np.isfinite(levels).all()
    np.testing.assert_array_equal(levels[:20], 0.0)


def test_sway_begins_still_and_has_the_stated_size():
    config = SwayConfig(sway_mm=2.0, sway_deg=0.5, neck_mm=(0.0, 0.0, 0.0))
    walk = poses(config, 4000, 3)
    np.testing.assert_array_equal(walk[0], np.eye(4)[:3])
    np.testing.assert_allclose(walk[100:, :, 3].std(axis=0), 2.0, rtol=0.2)
    angle = np.degrees(np.arccos((np.trace(walk[100:, :, :3], axis1=1, axis2=2) - 1) / 2))
    assert np.sqrt((angle**2).mean()) == pytest.approx(0.5 * np.sqrt(3), rel=0.2)
    steps = np.linalg.norm(np.diff(walk[:, :, 3], axis=0), axis=1)
    assert np.sqrt((steps**2).mean()) == pytest.approx(2 * np.sqrt(3 * 2 * 0.2), rel=0.1)
    np.testing.assert_array_equal(poses(config, 10, 3), walk[:10])
    assert not np.array_equal(poses(config, 10, 4), walk[:10])


def test_a_moved_subject_moves_whole(ball):
    pose = poses(SwayConfig(sway_mm=5.0, sway_deg=4.0), 3, 1)[2]
    other = moved(ball, pose)
    rotation, shift = pose[:, :3], pose[:, 3]
    assert np.linalg.norm(shift) > 0.5
    np.testing.assert_allclose(other.mesh.vertices, ball.mesh.vertices @ rotation.T + shift)
    np.testing.assert_allclose(other.normal, ball.normal @ rotation.T, atol=1e-6)
    head = other.head_from_world
    back = other.landmarks_mm @ head[:, :3].T + head[:, 3]
    np.testing.assert_allclose(back, ball.landmarks_mm, atol=1e-9)
