"""The default limits beside the sequences that the stage has."""

import numpy as np
import pytest

from lightstage.errors import ConfigError
from lightstage.patterns import SEQUENCES, sequence_patterns
from lightstage.rig import default_rig
from lightstage.safety import SafetyConfig, check_shots, flash_rate_per_s, light_on_s
from lightstage.sequence import Shot, plan_shots


def shots_of(*levels):
    return [Shot(f"s{i}", np.array(level, float)) for i, level in enumerate(levels)]


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


def test_both_limits_are_reported_at_once(small_rig):
    shots = plan_shots(["full", "x+", "x-", "y+", "y-", "z+", "z-"], small_rig)
    config = SafetyConfig(light_interval_s=0.05, max_light_on_s=10.0)
    with pytest.raises(ConfigError) as caught:
        check_shots(shots, small_rig, config, shot_worst_s=6.0)
    message = str(caught.value)
    assert "flashes per second, expected at most 3" in message
    assert "8 lamps over the budget" in message
    assert "up to 24 s" in message
