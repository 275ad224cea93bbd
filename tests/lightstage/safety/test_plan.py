"""A sequence is held against every limit before a light goes on."""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.errors import ConfigError
from lightstage.patterns import SEQUENCES, sequence_patterns
from lightstage.rig import default_rig
from lightstage.safety import (
    SafetyConfig,
    check_shots,
    flash_rate_per_s,
    light_on_s,
    photosensitivity_findings,
)
from lightstage.safety.plan import BOUNDS
from lightstage.sequence import Shot, plan_shots


def shots_of(*levels):
    return [Shot(f"s{i}", np.array(level, float)) for i, level in enumerate(levels)]


def test_the_darkness_before_and_after_belongs_to_the_sequence():
    shots = shots_of([1, 0], [0, 1], [1, 1])
    # Four changes: on, over, both on, off.
    assert flash_rate_per_s(shots, 0.1) == 2.0
    assert flash_rate_per_s(shots, 0.4) == 1.5
    assert flash_rate_per_s(shots, 1.1) == 0.5
    assert flash_rate_per_s(shots_of([0, 0]), 0.1) == 0


def test_light_time_is_level_times_worst_time():
    on_s = light_on_s(shots_of([1, 0], [0.5, 0], [1, 0.25]), 10.0)
    assert on_s.tolist() == [25.0, 2.5]


@pytest.mark.parametrize("drive", ["solid-angle", "on-off"])
@pytest.mark.parametrize("name", [*SEQUENCES, "olat"])
def test_the_default_limits_allow_every_named_sequence(name, drive):
    rig = default_rig()
    shots = plan_shots(sequence_patterns(name, rig), rig, drive)
    check_shots(shots, rig, SafetyConfig(), shot_worst_s=36.0)


def test_lights_by_solid_angle_flash_no_less_than_plain_ones():
    """Dimmer lights change the stage as often: the limit is on changes, not on their size."""
    rig = default_rig()
    rates = [
        flash_rate_per_s(plan_shots(SEQUENCES["binary"], rig, drive), 0.2)
        for drive in ("solid-angle", "on-off")
    ]
    assert rates[0] == rates[1] > 2


def test_all_limits_are_reported_at_once(small_rig):
    shots = plan_shots(["full", "x+", "x-", "y+", "y-", "z+", "z-"], small_rig, "on-off")
    config = SafetyConfig(light_interval_s=0.1, max_light_on_s=10.0, max_heat=0.05)
    with pytest.raises(ConfigError) as caught:
        check_shots(shots, small_rig, config, shot_worst_s=6.0)
    message = str(caught.value)
    assert "up to 4 flashes per second, expected at most 3" in message
    assert "duty: found 8 lamps over the budget" in message
    assert "up to 24 s at full level, expected at most 10 s" in message
    warm = 1 - np.exp(-24 / 300)
    assert f"heat: found 8 lamps over the budget, lamp 0 (corner0) up to {warm:.2f}" in message


def test_a_long_deadline_alone_can_break_the_warmth(small_rig):
    shots = plan_shots(["full"], small_rig, "on-off")
    patient = SafetyConfig(max_light_on_s=1000.0)
    check_shots(shots, small_rig, patient, shot_worst_s=690.0)
    with pytest.raises(ConfigError, match="sequence, heat: found 8 lamps"):
        check_shots(shots, small_rig, patient, shot_worst_s=691.0)


@pytest.mark.parametrize("field", list(SafetyConfig.__dataclass_fields__))
@pytest.mark.parametrize("value", [-1.0, -1e-9, np.nan, np.inf, -np.inf, 1e6, 1e300])
def test_a_limit_that_is_none_is_refused(field, value):
    with pytest.raises(ConfigError, match=f"safety, {field}: found .*, expected a number from"):
        SafetyConfig(**{field: value})


@pytest.mark.parametrize("field", list(SafetyConfig.__dataclass_fields__))
def test_a_limit_at_its_bounds_is_taken_and_one_with_which_nothing_could_be_lit_is_refused(
    field,
):
    for bound in BOUNDS[field]:
        assert getattr(SafetyConfig(**{field: bound}), field) == bound
    if field != "light_interval_s":
        with pytest.raises(ConfigError, match=field):
            SafetyConfig(**{field: 0.0})


def test_all_limits_that_are_none_are_reported_in_one_message():
    with pytest.raises(ConfigError) as caught:
        SafetyConfig(max_flashes_per_s=31.0, max_heat=2.0)
    assert "max_flashes_per_s: found 31, expected a number from 0.5 to 30" in str(caught.value)
    assert "max_heat: found 2" in str(caught.value)


def test_more_flashes_than_photosensitive_people_can_bear_are_warned_of():
    shots = shots_of([1, 0], [0, 1], [1, 1], [0, 0])
    assert photosensitivity_findings(shots, SafetyConfig()) == []
    quick = SafetyConfig(max_flashes_per_s=3.1, light_interval_s=0.1)
    (found,) = photosensitivity_findings(shots, quick)
    assert (found.severity, found.code) == ("warn", "photosensitivity")
    assert "3.1 flashes per second allowed, of which these patterns need up to 2" in str(found)
    assert "seizures" in found.hint
