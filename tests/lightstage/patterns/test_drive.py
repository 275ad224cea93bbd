"""What is driven: sums to the last step of the wire, banks, single lights, the user's own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import PatternError
from lightstage.leds.wire import level_counts
from lightstage.patterns import (
    SEQUENCES,
    UserPattern,
    complement,
    drive_levels,
    light_weights,
    pattern_levels,
)
from lightstage.rig import default_rig
from tests.lightstage.patterns.rigs import any_rig, rig_at

PAIRS = [("x+", "x-"), ("y+", "y-"), ("z+", "z-"), ("mux-1", "mux-2")]
PAIRS += [(f"lin-{a}", f"lin-{b}") for a, b in PAIRS[:3]]
drives = st.sampled_from(["solid-angle", "on-off"])


def own_of(levels, is_field):
    return {"mine": UserPattern("mine", "levels", np.array(levels), is_field, None, "")}


@settings(max_examples=60)
@given(any_rig(), drives)
def test_pairs_sum_to_full_to_the_step_on_the_wire(rig, drive):
    full = level_counts(drive_levels("full", rig, drive)).astype(int)
    for first, second in PAIRS:
        counts = [level_counts(drive_levels(n, rig, drive)).astype(int) for n in (first, second)]
        assert np.array_equal(counts[0] + counts[1], full)


@settings(max_examples=40)
@given(any_rig(), drives, st.sampled_from(["full", "x+", "y-", "lin-z-", "mux-1", "olat-000"]))
def test_the_two_banks_of_a_pattern_make_it_up(rig, drive, name):
    whole = drive_levels(name, rig, drive)
    parts = [drive_levels(f"{name}@{bank}", rig, drive) for bank in ("parallel", "cross")]
    assert np.array_equal(parts[0] + parts[1], whole)
    assert not (parts[0] * parts[1]).any()


@settings(max_examples=40)
@given(any_rig(), drives)
def test_driven_levels_are_the_names_levels_times_the_weights(rig, drive):
    weights = light_weights(rig) if drive == "solid-angle" else np.ones(len(rig.lights))
    for name in (n for names in SEQUENCES.values() for n in names):
        driven = drive_levels(name, rig, drive)
        assert np.abs(driven - weights * pattern_levels(name, rig)).max() <= 1.01 / 65535
        assert ((driven >= 0) & (driven <= 1)).all()
        # Whole steps: what is recorded is what the wire carries.
        assert np.array_equal(level_counts(driven) / 65535, driven)


def test_on_and_off_is_level_1_and_nothing():
    rig = default_rig()
    for name in SEQUENCES["binary"]:
        assert np.array_equal(drive_levels(name, rig, "on-off"), pattern_levels(name, rig))


def test_a_light_on_a_splitting_plane_is_split_evenly_to_one_step():
    rig = rig_at(np.concatenate([np.eye(3), -np.eye(3)]) * 1000)
    for drive in ("solid-angle", "on-off"):
        plus, minus = (level_counts(drive_levels(n, rig, drive)).astype(int) for n in ("x+", "x-"))
        assert np.abs(plus - minus)[[1, 2, 4, 5]].max() <= 1
        assert (plus + minus == 65535).all()


def test_a_single_light_and_darkness_are_driven_alike_either_way():
    rig = default_rig()
    for drive in ("solid-angle", "on-off"):
        assert drive_levels("olat-000", rig, drive).tolist() == [1.0] + [0.0] * 167
        assert not drive_levels("dark", rig, drive).any()


def test_every_pattern_but_those_that_stand_alone_has_its_complement():
    for name in (n for names in SEQUENCES.values() for n in names):
        mate = complement(name)
        if name.partition("@")[0] in ("full", "dark"):
            assert mate is None
        else:
            assert mate != name
            assert complement(mate) == name
            assert mate.partition("@")[2] == name.partition("@")[2]
    assert complement("olat-000") is None
    assert complement("mine") is None


def test_ones_own_field_is_weighted_and_ones_own_levels_are_not():
    rig = default_rig()
    ramp = np.linspace(0, 1, 168)
    assert np.allclose(drive_levels("mine", rig, own=own_of(ramp, False)), ramp, atol=1e-5)
    field = drive_levels("mine", rig, own=own_of(ramp, True))
    assert np.allclose(field, ramp * light_weights(rig), atol=1e-5)
    plain = drive_levels("mine", rig, "on-off", own_of(ramp, True))
    assert np.allclose(plain, ramp, atol=1e-5)


def test_ones_own_pattern_can_be_polarised():
    rig = default_rig()
    own = own_of(np.full(168, 0.5), False)
    parts = [drive_levels(f"mine@{bank}", rig, own=own) for bank in ("parallel", "cross")]
    assert np.array_equal(parts[0] + parts[1], drive_levels("mine", rig, own=own))
    with pytest.raises(PatternError, match="mine@up"):
        drive_levels("mine@up", rig, own=own)


def test_an_unknown_name_is_reported_with_ones_own():
    with pytest.raises(PatternError, match="of your own: mine"):
        drive_levels("yours", default_rig(), own=own_of(np.ones(168), False))
    with pytest.raises(PatternError, match="olat-900: found no lamp of this id"):
        drive_levels("olat-900", default_rig())
