"""Patterns: names to levels, from first principles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import PatternError
from lightstage.patterns import (
    MEANINGS,
    SEQUENCES,
    light_weights,
    on_plane,
    pattern_levels,
    sequence_patterns,
)
from lightstage.patterns.names import has_coloured_lights, is_reserved
from lightstage.rig import Light, Rig, default_rig


def rig_at(*places):
    lights = [
        Light(i, f"l{i}", p, "horizontal" if i % 2 else "vertical") for i, p in enumerate(places)
    ]
    return Rig(tuple(lights), ())


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_binary_pattern_lights_one_side(axis):
    rig = default_rig()
    name = "xyz"[axis]
    plus, minus = pattern_levels(f"{name}+", rig), pattern_levels(f"{name}-", rig)
    side = rig.positions_mm[:, axis]
    assert (plus[side > 1] == 1).all()
    assert (plus[side < -1] == 0).all()
    assert np.array_equal(plus + minus, pattern_levels("full", rig))


def test_a_light_on_the_plane_is_half_in_each():
    rig = rig_at((0, 1250, 0), (1e-4, 1250, 0), (1e-2, 1250, 0), (-1e-2, 1250, 0))
    assert pattern_levels("x+", rig).tolist() == [0.5, 0.5, 1.0, 0.0]
    assert pattern_levels("x-", rig).tolist() == [0.5, 0.5, 0.0, 1.0]


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(st.lists(directions, min_size=1, max_size=10), st.floats(1.0, 1e6))
def test_pairs_sum_to_full_at_any_place_and_scale(places, scale):
    unit = [np.array(p) / np.linalg.norm(p) * scale for p in places]
    rig = rig_at(*[tuple(p) for p in unit])
    for name in ("x", "y", "z", "lin-x", "lin-y", "lin-z"):
        plus, minus = pattern_levels(f"{name}+", rig), pattern_levels(f"{name}-", rig)
        assert np.allclose(plus + minus, 1)
        assert ((plus >= 0) & (plus <= 1)).all()


def test_a_linear_gradient_goes_with_the_direction():
    rig = rig_at((1250, 0, 0), (-1250, 0, 0), (0, 0, 1250), (0, 300, 400))
    assert pattern_levels("lin-x+", rig).tolist() == [1, 0, 0.5, 0.5]
    assert pattern_levels("lin-z+", rig).tolist() == [0.5, 0.5, 1, 0.9]


def test_one_light_is_named_by_its_id_not_its_place():
    rig = Rig(tuple(reversed(default_rig().lights)), ())
    levels = pattern_levels("olat-003", rig)
    assert levels.sum() == 1
    assert rig.lights[int(levels.argmax())].id == 3


def test_a_polarised_pattern_lights_one_bank():
    rig = default_rig()
    parallel, cross = pattern_levels("x+@parallel", rig), pattern_levels("x+@cross", rig)
    assert np.array_equal(parallel + cross, pattern_levels("x+", rig))
    for levels, bank in ((parallel, "vertical"), (cross, "horizontal")):
        assert {light.bank for light, on in zip(rig.lights, levels, strict=True) if on} == {bank}


def test_dark_is_dark():
    assert not pattern_levels("dark", default_rig()).any()


@pytest.mark.parametrize(
    "name",
    [
        "",
        "X+",
        "x",
        "x+ ",
        "lin-full",
        "olat-1",
        "olat-",
        "x+@",
        "full@up",
        "@cross",
        "x+@cross@cross",
    ],
)
def test_an_unknown_pattern_is_refused_and_the_known_ones_listed(name):
    with pytest.raises(PatternError, match=r"unknown name, expected full, dark"):
        pattern_levels(name, default_rig())


def test_a_light_that_the_rig_lacks_is_refused():
    with pytest.raises(PatternError, match="olat-168: found no lamp of this id"):
        pattern_levels("olat-168", default_rig())


def test_sequences_are_named_or_listed():
    assert sequence_patterns("binary") == ("full", "x+", "x-", "y+", "y-", "z+", "z-")
    assert sequence_patterns(" full, olat-000 ,") == ("full", "olat-000")
    for names in SEQUENCES.values():
        for name in names:
            pattern_levels(name, default_rig())


def test_mux_holds_all_six_gradients_where_lights_are_coloured():
    """Three lights of one colour each at every place: channel by channel a binary gradient."""
    places = np.repeat(default_rig().positions_mm, 3, axis=0)
    colours = np.tile(np.eye(3), (168, 1))
    lights = [
        Light(i, f"l{i}", tuple(p), "vertical", tuple(c))
        for i, (p, c) in enumerate(zip(places.tolist(), colours.tolist(), strict=True))
    ]
    rig = Rig(tuple(lights), ())
    assert has_coloured_lights(rig)
    for shot, sign in (("mux-1", "+"), ("mux-2", "-")):
        levels = pattern_levels(shot, rig)
        for channel, axis in enumerate("xyz"):
            known = pattern_levels(axis + sign, default_rig())
            assert np.array_equal(levels[channel::3], known)


def test_mux_is_one_diagonal_gradient_where_lights_are_white():
    rig = default_rig()
    assert not has_coloured_lights(rig)
    first, second = pattern_levels("mux-1", rig), pattern_levels("mux-2", rig)
    assert np.allclose(first + second, 1)
    assert np.allclose(first, sum(pattern_levels(f"{a}+", rig) for a in "xyz") / 3)
    moment = (first * light_weights(rig)) @ rig.positions_mm
    assert np.allclose(moment / moment.max(), 1, atol=0.05)


def test_a_light_without_gain_has_a_level_too():
    rig = Rig((Light(0, "l", (1000.0, 1000.0, -1000.0), "vertical", (0.0, 0.0, 0.0)),), ())
    assert pattern_levels("mux-1", rig) == pytest.approx([2 / 3])


def test_the_sequence_olat_goes_through_the_rigs_lights():
    rig = default_rig()
    names = sequence_patterns("olat", rig)
    assert len(names) == 168
    assert np.array_equal(sum(pattern_levels(n, rig) for n in names), np.ones(168))
    with pytest.raises(PatternError, match="found no rig"):
        sequence_patterns("olat")


def test_sequences_may_be_joined_with_each_other_and_with_patterns():
    assert sequence_patterns("mux,dark, polarised") == (
        "mux-1", "mux-2", "dark", "full@parallel", "full@cross",
    )  # fmt: skip


def test_every_sequence_is_explained():
    assert list(MEANINGS) == [*SEQUENCES, "olat"]


def test_lights_on_a_splitting_plane_are_reported_by_axis():
    rig = rig_at((0, 1250, 0), (1e-4, 900, 900), (800, 0, 900), (1, 1, 1))
    assert on_plane(rig) == {"x": [0, 1], "y": [2], "z": [0]}
    assert on_plane(default_rig()) == {}


@pytest.mark.parametrize("name", ["full", "dark", "x+", "lin-z-", "olat", "olat-000", "mux-1"])
def test_names_of_the_stage_are_reserved(name):
    assert is_reserved(name)
    assert not is_reserved("rim-light")
