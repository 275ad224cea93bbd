"""Patterns: names to levels, from first principles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import PatternError
from lightstage.patterns import SEQUENCES, pattern_levels, sequence_patterns
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
    with pytest.raises(PatternError, match="olat-168: found no light of this id"):
        pattern_levels("olat-168", default_rig())


def test_sequences_are_named_or_listed():
    assert sequence_patterns("binary") == ("full", "x+", "x-", "y+", "y-", "z+", "z-")
    assert sequence_patterns(" full, olat-000 ,") == ("full", "olat-000")
    for names in SEQUENCES.values():
        for name in names:
            pattern_levels(name, default_rig())
