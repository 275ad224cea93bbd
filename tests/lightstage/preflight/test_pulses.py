"""How far pulsed light can be off in one exposure."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from lightstage.preflight.config import PreflightConfig
from lightstage.preflight.pulses import (
    MARKS,
    exposure_error,
    nearest_mark,
    possible_exposures_s,
    pulse_findings,
    worst_error,
)

GRID = 20_000
"""Samples of the wave in a period."""


def light_of_exposures(periods, level, phases):
    """Light in exposures that begin at these phases: the wave, sampled and summed."""
    span = round(periods * GRID)
    on = np.arange(GRID * 2 + span) % GRID < level * GRID
    light = np.concatenate([[0], np.cumsum(on)])
    begin = (phases * GRID).astype(int)
    return (light[begin + span] - light[begin]) / (span * level)


def grain(periods, level):
    """How far sums of samples may be off: one sample at the edges of each pulse."""
    return (periods + 2) / GRID / (periods * level)


@given(st.floats(0.05, 20.0), st.floats(0.02, 1.0), st.integers(0, 2**32 - 1))
def test_no_phase_gives_more_error_than_the_formula_says(periods, level, seed):
    periods = round(periods * GRID) / GRID
    light = light_of_exposures(periods, level, np.random.default_rng(seed).random(64))
    assert np.abs(light - 1.0).max() <= worst_error(periods, level) + grain(periods, level)


@pytest.mark.parametrize("periods", [0.3, 1.5, 2.25, 6.67, 7.87, 12.01])
@pytest.mark.parametrize("level", [0.05, 0.3, 0.5, 0.9])
def test_some_phase_gives_the_error_that_the_formula_says(periods, level):
    found = np.abs(light_of_exposures(periods, level, np.arange(4000) / 4000) - 1.0).max()
    assert found == pytest.approx(worst_error(periods, level), abs=2 * grain(periods, level))


@given(st.integers(1, 10**6), st.floats(1e-4, 1.0))
def test_whole_numbers_of_periods_have_no_error(periods, level):
    assert worst_error(float(periods), level) <= 1e-9


@given(st.floats(1e-6, 1e6))
def test_a_full_light_has_no_error(periods):
    assert worst_error(periods, 1.0) <= 1e-9


@given(st.floats(1e-3, 1e6), st.floats(1e-4, 1.0), st.floats(1e-4, 1.0))
def test_brighter_lights_are_off_by_no_larger_share(periods, one, other):
    low, high = sorted((one, other))
    assert worst_error(periods, high) <= worst_error(periods, low) + 1e-9


@given(st.floats(1.0, 1e6), st.floats(1e-4, 1.0))
def test_the_error_is_at_most_one_period_of_all(periods, level):
    assert worst_error(periods, level) <= 1.0 / periods + 1e-9


@pytest.mark.parametrize(
    ("text", "true_s"), [("1/60", 1 / 64), ("0.0166s", 1 / 64), ("1/125", 1 / 128), ("30", 32.0)]
)
def test_a_marked_time_may_last_its_power_of_two(text, true_s):
    assert possible_exposures_s(text, "true") == (pytest.approx(true_s),)
    assert possible_exposures_s(text, "either")[1 if true_s < 1 else 0] > 0
    assert len(possible_exposures_s(text, "either")) == 2


def test_the_marked_time_of_a_cut_text_is_the_mark():
    assert possible_exposures_s("0.0166s", "marked") == (pytest.approx(1 / 60),)
    assert nearest_mark(0.0166, 1e-4) == "1/60"
    assert nearest_mark(1 / 64) is None


def test_a_time_off_the_series_is_taken_as_it_stands():
    assert possible_exposures_s("0.0451", "either") == (pytest.approx(0.0451),)


@pytest.mark.parametrize("text", ["Bulb", "", "x", "0"])
def test_no_time_has_no_error_to_tell(text):
    assert possible_exposures_s(text, "either") == ()
    assert exposure_error(text, 400.0, 0.1, "either") is None


@given(st.sampled_from(MARKS), st.floats(1.0, 1e5), st.floats(1e-4, 1.0))
def test_either_series_is_never_better_than_one_of_them(text, pulse_hz, level):
    both = exposure_error(text, pulse_hz, level, "either")
    for series in ("marked", "true"):
        assert both >= exposure_error(text, pulse_hz, level, series)


def test_a_part_of_a_pulse_blocks_and_whole_times_are_offered():
    config = PreflightConfig(shutter_series="true")
    found = pulse_findings({"cam0": "1/60", "cam1": "1/60", "cam2": "1/8"}, 400.0, 0.1, config)
    (finding,) = found
    assert finding.severity == "refuse"
    assert finding.where == "cameras cam0, cam1, shutter"
    assert "6.25 pulses of 400 Hz" in finding.found
    # True times: 1/16 s (marked 1/15) is 25 pulses; no shorter one is whole.
    assert "Set 1/15 s" in finding.hint


@given(st.sampled_from(MARKS), st.sampled_from([120.0, 400.0, 1000.0, 2000.0, 25_000.0]))
def test_offered_times_are_not_refused_themselves(text, pulse_hz):
    config = PreflightConfig()
    found = pulse_findings({"cam0": text}, pulse_hz, 1e-4, config)
    assume(found and found[0].hint.startswith("Set"))
    offered = found[0].hint.split(" s, and")[0].removeprefix("Set ").split(" or ")
    for mark in offered:
        assert pulse_findings({"cam0": mark}, pulse_hz, 1e-4, config) == []


def test_lights_on_or_off_or_dimmed_by_current_show_no_pulses():
    config = PreflightConfig()
    assert pulse_findings({"cam0": "1/61"}, 400.0, 1.0, config) == []
    assert pulse_findings({"cam0": "1/61"}, 0, 0.1, config) == []


def test_an_unknown_frequency_is_reported_to_be_not_verified():
    (finding,) = pulse_findings({"cam0": "1/60"}, None, 0.1, PreflightConfig())
    assert finding.severity == "warn"
    assert "Not verified" in finding.hint


def test_the_simulated_shutter_sees_what_the_formula_says():
    from sim.camera.flaws import PulseConfig
    from sim.camera.pulses import band_gain

    exposure_s, level = 1 / 64, 0.3
    pulses = PulseConfig(frequency_hz=400.0, readout_ms=15.0)
    gains = [band_gain(level, 500, exposure_s, phase, pulses) for phase in np.arange(50) / 50]
    found = np.abs(np.array(gains) - 1).max()
    assert math.isclose(found, worst_error(exposure_s * 400.0, level), rel_tol=0.02)
