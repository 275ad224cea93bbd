"""Shots of a sequence."""

import numpy as np
import pytest

from lightstage.errors import PatternError
from lightstage.patterns import drive_levels
from lightstage.rig import default_rig
from lightstage.sequence import plan_shots


def test_all_wrong_patterns_are_reported_at_once(small_rig):
    with pytest.raises(PatternError, match=r"(?s)3 problems.*'nope'.*'full'.*twice.*olat-100"):
        plan_shots(["full", "nope", "full", "olat-100"], small_rig)


def test_an_empty_sequence_is_refused(small_rig):
    with pytest.raises(PatternError, match="sequence: found no pattern"):
        plan_shots([], small_rig)


def test_a_plan_drives_by_solid_angle_unless_told_otherwise():
    rig = default_rig()
    names = ["full", "x+@cross", "olat-007"]
    for shot, plain in zip(plan_shots(names, rig), plan_shots(names, rig, "on-off"), strict=True):
        assert np.array_equal(shot.levels, drive_levels(shot.pattern, rig))
        assert np.array_equal(plain.levels, drive_levels(shot.pattern, rig, "on-off"))
        assert shot.pattern == plain.pattern
    assert plan_shots(["full"], rig)[0].levels.mean() < 0.7
    assert plan_shots(["full"], rig, "on-off")[0].levels.min() == 1
