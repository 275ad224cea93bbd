"""`lightstage rig check`, rigs without polarisers, and mistakes that all lights share."""

from __future__ import annotations

import dataclasses
import json

import cv2
import numpy as np
import pytest

from lightstage.errors import FormatError, PatternError
from lightstage.patterns import pattern_levels
from lightstage.patterns.picture import pattern_sheet
from lightstage.rig import (
    LightAddress,
    Rig,
    default_rig,
    load_rig,
    look_at,
    rig_from_json,
    rig_sha256,
    rig_to_json,
    save_rig,
)
from lightstage.rig_oddities import odd_lights, rig_oddities
from lightstage.rig_picture import draw_rig
from tests.programs import run_program


def value():
    return json.loads(json.dumps(rig_to_json(default_rig())))


def test_a_rig_without_banks_is_read_written_and_refuses_polarised_patterns_alone(tmp_path):
    printed = value()
    for light in printed["lights"]:
        del light["bank"]
    rig = rig_from_json(printed, "rig.json")
    assert {light.bank for light in rig.lights} == {None}
    again = load_rig(save_rig(rig, tmp_path / "rig.json"))
    assert again.lights == rig.lights
    assert "bank" not in json.loads((tmp_path / "rig.json").read_text())["lights"][0]
    assert rig_sha256(again) == rig_sha256(rig) != rig_sha256(default_rig())
    assert pattern_levels("x+", rig).any()
    with pytest.raises(PatternError, match="a rig whose lights have no bank"):
        pattern_levels("x+@cross", rig)
    assert pattern_sheet(rig, [("full", pattern_levels("full", rig))], "all").any()
    assert rig_oddities(rig) == []


@pytest.mark.parametrize(
    "damage",
    [
        lambda light: light.update(bank="left"),
        lambda light: light.pop("name"),
        lambda light: light.update(position_mm=[0, 0, float("nan")]),
        lambda light: light.update(rgb_gain=[-1, 1, 1]),
        lambda light: light.update(bnak=light.pop("bank"), position=light.pop("position_mm")),
    ],
)
def test_one_mistake_in_all_lights_is_one_line(damage):
    printed = value()
    for light in printed["lights"]:
        damage(light)
    with pytest.raises(FormatError, match="and 167 more") as caught:
        rig_from_json(printed, "rig.json")
    assert "\n" not in str(caught.value)


def test_unlike_mistakes_stay_apart():
    printed = value()
    printed["lights"][3]["bank"] = "left"
    printed["lights"][5]["rgb_gain"] = [-1, 1, 1]
    printed["cameras"][1]["fx_px"] = 0
    with pytest.raises(FormatError, match="3 problems"):
        rig_from_json(printed, "rig.json")


def test_a_stage_in_metres_is_noticed():
    printed = value()
    for light in printed["lights"]:
        light["position_mm"] = [x / 1000 for x in light["position_mm"]]
    with pytest.raises(FormatError, match=r"1\.25 mm radius.*Are they metres") as caught:
        rig_from_json(printed, "rig.json")
    assert "\n" not in str(caught.value)


def changed(**fields):
    rig = default_rig()
    return dataclasses.replace(rig, **fields)


def moved(rig: Rig, index: int, place) -> Rig:
    lights = list(rig.lights)
    lights[index] = dataclasses.replace(lights[index], position_mm=tuple(map(float, place)))
    return dataclasses.replace(rig, lights=tuple(lights))


def with_camera(index: int, **fields) -> Rig:
    rig = default_rig()
    cameras = list(rig.cameras)
    cameras[index] = dataclasses.replace(cameras[index], **fields)
    return dataclasses.replace(rig, cameras=tuple(cameras))


ODD = {
    "distance": moved(default_rig(), 7, [0, 0, 1800]),
    "close": moved(default_rig(), 7, np.array(default_rig().lights[8].position_mm) + 1),
    "one-sided": changed(
        lights=tuple(one for one in default_rig().lights if one.position_mm[2] > 300)
    ),
    "bank": changed(lights=tuple(one for one in default_rig().lights if one.bank == "vertical")),
    "gain": changed(
        lights=tuple(
            dataclasses.replace(light, rgb_gain=(0.0, 0.0, 0.0)) if light.id == 3 else light
            for light in default_rig().lights
        )
    ),
    "aim": with_camera(1, cam_from_world=look_at(np.array([0, 0, 1100.0]), np.array([0, 0, 2e3]))),
    "roll": with_camera(
        0, cam_from_world=np.diag([-1.0, -1.0, 1.0]) @ default_rig().cameras[0].cam_from_world
    ),
    "centre": with_camera(2, cx_px=100.0),
    "focal": with_camera(2, fx_px=1.2 * default_rig().cameras[2].fx_px),
    "focal-length": with_camera(2, fx_px=105.0, fy_px=105.0),
    "same-place": with_camera(1, cam_from_world=default_rig().cameras[0].cam_from_world),
    "serial": with_camera(1, serial=default_rig().cameras[0].serial),
    "front": changed(
        cameras=(
            dataclasses.replace(
                default_rig().cameras[0],
                cam_from_world=look_at(np.array([1000.0, 0, 300.0]), np.zeros(3)),
            ),
        )
    ),
}


def test_nothing_is_odd_about_the_default_rig():
    assert rig_oddities(default_rig()) == []
    assert not odd_lights(default_rig()).any()


@pytest.mark.parametrize("code", ODD)
def test_what_is_odd_is_reported(code):
    rig = ODD[code]
    codes = {finding.code for finding in rig_oddities(rig)}
    assert code in codes
    assert draw_rig(rig).shape == draw_rig(default_rig()).shape


def test_the_command_draws_and_says(tmp_path):
    rig = save_rig(ODD["distance"], tmp_path / "rig.json")
    picture = tmp_path / "rig.png"
    done = run_program("lightstage", "rig", "check", rig, "--out", picture, "--json")
    assert done.code == 0, done.err
    facts = json.loads(done.out.splitlines()[-1])
    assert [each["code"] for each in facts["odd"]] == ["distance"]
    assert facts["lights"] == 168
    shown = cv2.imread(str(picture))[..., ::-1].astype(int)
    red = (shown[..., 0] > 200) & (shown[..., 1:].max(axis=2) < 120)
    assert red.any()
    plain = draw_rig(default_rig()).astype(int)
    assert not ((plain[..., 0] > 200) & (plain[..., 1:].max(axis=2) < 120)).any()


def test_the_command_names_which_channels_a_rig_uses(tmp_path):
    lights = [
        dataclasses.replace(light, address=LightAddress(3 + light.id))
        for light in default_rig().lights
    ]
    rig = save_rig(changed(lights=tuple(lights)), tmp_path / "rig.json")
    done = run_program("lightstage", "rig", "check", rig, "--json")
    assert done.code == 0, done.err
    facts = json.loads(done.out.splitlines()[-1])
    assert (facts["addressed"], facts["channels"], facts["odd"]) == (True, {"main": [3, 170]}, [])
    message = run_program("lightstage", "rig", "check", rig).out
    assert "168 lamps on channels 3 to 170, 9 cameras" in message


def test_the_command_names_which_channels_of_which_controller_a_rig_uses(tmp_path):
    lights = [
        dataclasses.replace(light, address=LightAddress(light.id // 2, "ab"[light.id % 2]))
        for light in default_rig().lights
    ]
    rig = save_rig(changed(lights=tuple(lights)), tmp_path / "rig.json")
    message = run_program("lightstage", "rig", "check", rig).out
    assert "168 lamps on channels 0 to 83 of a, channels 0 to 83 of b, 9 cameras" in message
    assert "nothing odd" in message
