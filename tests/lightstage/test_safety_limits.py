"""Flash rate and duty, against counts made by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import ConfigError
from lightstage.rig import default_rig
from lightstage.safety import SafetyConfig, check_shots, flash_rate_per_s, light_on_s
from lightstage.sequence import Shot, plan_shots


def shots_of(*levels):
    return [Shot(f"s{i}", np.array(level, float)) for i, level in enumerate(levels)]


def test_each_change_counts_as_a_flash_and_the_last_darkness_too():
    shots = shots_of([1, 0], [0, 1], [1, 1])
    assert flash_rate_per_s(shots, 0.1) == 4
    assert flash_rate_per_s(shots, 0.5) == 2
    assert flash_rate_per_s(shots, 1.0) == 1
    assert flash_rate_per_s(shots, 0.4) == 3


def test_a_light_that_does_not_change_does_not_flash():
    assert flash_rate_per_s(shots_of([1, 1], [1, 1], [1, 1]), 0.1) == 2
    assert flash_rate_per_s(shots_of([0, 0]), 0.1) == 0


@given(
    st.lists(st.lists(st.sampled_from([0.0, 0.5, 1.0]), min_size=2, max_size=2), min_size=1),
    st.floats(0.05, 3.0),
)
def test_flash_rate_matches_a_plain_count_over_sliding_windows(levels, interval_s):
    states = [[0.0, 0.0], *levels, [0.0, 0.0]]
    times = [i * interval_s for i in range(1, len(states)) if states[i] != states[i - 1]]
    plain = max((sum(t0 <= t < t0 + 1.0 for t in times) for t0 in times), default=0)
    assert flash_rate_per_s(shots_of(*levels), interval_s) == plain


def test_light_time_is_level_times_worst_time():
    on_s = light_on_s(shots_of([1, 0], [0.5, 0], [1, 0.25]), 10.0)
    assert on_s.tolist() == [25.0, 2.5]


def test_the_default_limits_allow_the_default_sequences_on_the_default_rig():
    rig = default_rig()
    for names in (["full", "x+", "x-", "y+", "y-", "z+", "z-"], ["full", "lin-x+", "lin-x-"]):
        check_shots(plan_shots(names, rig), rig, SafetyConfig(), shot_worst_s=36.0)


def test_both_limits_are_told_at_once(small_rig):
    shots = plan_shots(["full", "x+", "x-"], small_rig)
    config = SafetyConfig(light_interval_s=0.2, max_light_on_s=10.0)
    with pytest.raises(ConfigError) as caught:
        check_shots(shots, small_rig, config, shot_worst_s=6.0)
    said = str(caught.value)
    assert "up to 4 flashes per second, expected at most 3" in said
    assert "8 lights over the budget" in said
    assert "up to 12 s" in said
