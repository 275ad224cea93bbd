"""Emitters of several colours in one place: named in rig.json, driven by colour."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.capture.config import CaptureConfig
from lightstage.errors import PatternError, RigError
from lightstage.formats.config import make_config
from lightstage.patterns import drive_levels, light_weights, split_emitters
from lightstage.patterns.names import BINARY, has_coloured_lights
from lightstage.patterns.weights import unevenness
from lightstage.rig import (
    Rig,
    default_rig,
    load_rig,
    rig_from_json,
    rig_sha256,
    rig_to_json,
    save_rig,
)
from lightstage.rig_oddities import rig_oddities
from lightstage.sequence import plan_shots

GAINS = {
    "red": (3.0, 0.0, 0.0),
    "green": (0.0, 3.0, 0.0),
    "blue": (0.0, 0.0, 3.0),
    "warm": (1.2, 1.0, 0.6),
    "neutral": (1.0, 1.0, 1.0),
    "cool": (0.8, 1.0, 1.4),
}


def six_colours(offset_mm: float = 0.0) -> Rig:
    """The default stage with six emitters on each board, a little apart from each other."""
    lights = []
    for light in default_rig().lights:
        for k, (colour, gain) in enumerate(GAINS.items()):
            place = np.array(light.position_mm) + offset_mm * np.array([k % 3 - 1, k // 3, 0])
            lights.append(
                dataclasses.replace(
                    light, id=6 * light.id + k, name=f"{light.name}/{colour}", colour=colour,
                    rgb_gain=gain, position_mm=tuple(map(float, place)),
                )
            )  # fmt: skip
    return dataclasses.replace(default_rig(), lights=tuple(lights))


RIG = six_colours(4.0)
colours = st.lists(st.sampled_from(sorted(GAINS)), min_size=1, unique=True)


def test_colours_stand_in_the_file_and_change_no_rig_without_them(tmp_path):
    again = load_rig(save_rig(RIG, tmp_path / "rig.json"))
    assert again.lights == RIG.lights
    assert rig_sha256(again) == rig_sha256(RIG)
    assert "colour" not in rig_to_json(default_rig())["lights"][0]
    assert [*RIG.colours] == [*GAINS]
    assert all(which.sum() == 168 for which in RIG.colours.values())
    assert rig_oddities(RIG) == []
    facts = json.loads(json.dumps(rig_to_json(RIG)))
    for light in facts["lights"]:
        light["colour"] = "Warm White"
    with pytest.raises(RigError, match=r"colour and 1007 more: found 'Warm White', expected small"):
        rig_from_json(facts, "rig.json")


def test_emitters_in_one_place_that_name_no_colour_are_odd():
    plain = tuple(dataclasses.replace(light, colour=None) for light in RIG.lights)
    close = dataclasses.replace(RIG, lights=(*plain[:30], *default_rig().lights[5:]))
    assert any("`colour` each" in str(finding) for finding in rig_oddities(close))


def test_each_colour_is_as_even_a_field_as_if_it_stood_alone():
    alone = light_weights(default_rig())
    weights = light_weights(six_colours())
    for which in RIG.colours.values():
        np.testing.assert_allclose(weights[which], alone, rtol=1e-9)
    assert unevenness(RIG, drive_levels("full", RIG)) < 0.006


@given(colours, st.sampled_from(["solid-angle", "on-off"]), st.sampled_from(["x", "y", "z"]))
def test_only_the_named_colours_are_lit_and_pairs_sum_to_full(names, drive, axis):
    full = drive_levels("full", RIG, drive, emitters=names)
    lit = np.array([light.colour in names for light in RIG.lights])
    assert (full[lit] > 0).all()
    assert not full[~lit].any()
    assert full.max() == 1.0
    parts = [drive_levels(f"{axis}{sign}", RIG, drive, emitters=names) for sign in "+-"]
    assert np.array_equal(np.round((parts[0] + parts[1]) * 65535), np.round(full * 65535))


def test_colours_together_are_the_sum_of_each():
    both = drive_levels("full", RIG, "on-off", emitters=("warm", "cool"))
    one = [drive_levels("full", RIG, "on-off", emitters=(name,)) for name in ("warm", "cool")]
    assert np.array_equal(both, one[0] + one[1])
    every = drive_levels("full", RIG, emitters=tuple(GAINS))
    assert np.array_equal(every, drive_levels("full", RIG))


def test_mux_by_red_green_and_blue_emitters_holds_six_gradients():
    names = ("red", "green", "blue")
    assert has_coloured_lights(RIG)
    levels = drive_levels("mux-1", RIG, "on-off", emitters=names)
    for channel, axis in enumerate("xyz"):
        which = RIG.colours[names[channel]]
        assert np.array_equal(levels[which], drive_levels(f"{axis}+", RIG, "on-off")[which])


@pytest.mark.parametrize(
    ("rig", "names", "pattern", "message"),
    [
        (RIG, ("warm", "violet"), "full", r"--emitters: found 'violet', expected some of red, "),
        (default_rig(), ("warm",), "full", r"lights with `colour` in rig.json. All lights of this"),
        (RIG, ("warm",), "olat-000", r"olat-000: found a light of another colour, expected one of"),
    ],
)
def test_colours_that_cannot_be_driven_are_reported(rig, names, pattern, message):
    with pytest.raises(PatternError, match=message):
        plan_shots([pattern], rig, emitters=names)


def test_colours_come_from_the_configuration_and_the_command_line():
    assert make_config(CaptureConfig, {"emitters": ["warm", "cool"]}, "c").emitters == (
        "warm",
        "cool",
    )
    assert split_emitters(" warm, cool,") == ("warm", "cool")
    shots = plan_shots(BINARY, RIG, emitters=("warm",))
    assert all(shot.levels[RIG.colours["warm"]].any() for shot in shots)
