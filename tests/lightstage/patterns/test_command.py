"""`lightstage patterns`, as an operator runs it."""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from lightstage.commands import make_app
from lightstage.errors import ConfigError, LightstageError, PatternError
from lightstage.formats.exr import write_exr
from lightstage.patterns import drive_levels
from lightstage.patterns.command import register
from lightstage.rig import load_rig, save_rig
from tests.lightstage.patterns.rigs import rig_at


def run(*arguments):
    """Exit code's error where there is one, and the lines printed."""
    app = make_app("test")
    register(app)
    app.command("other")(lambda: None)
    result = CliRunner().invoke(app, ["patterns", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output.splitlines()


@pytest.fixture
def octahedron(tmp_path):
    places = np.concatenate([np.eye(3), -np.eye(3)]) * 1000.0
    return save_rig_with_camera(tmp_path, places)


def save_rig_with_camera(tmp_path, places):
    from dataclasses import replace

    from lightstage.rig import default_rig

    rig = replace(rig_at(places), cameras=default_rig().cameras[:1])
    return save_rig(rig, tmp_path / "rig.json")


def test_without_a_sequence_they_are_listed():
    message = "\n".join(run())
    for name, shots in (("binary", 7), ("mux", 2), ("olat", 168), ("ambient", 8)):
        assert any(line.split()[:2] == [name, str(shots)] for line in message.splitlines())


def test_a_sequence_is_told_pattern_by_pattern_with_the_evenness_of_full():
    lines = run("binary")
    assert [line.split()[:2] for line in lines[1:8]] == [
        ["full", "168"], *([f"{a}{s}", "84"] for a in "xyz" for s in "+-"),
    ]  # fmt: skip
    assert lines[-1].startswith("7 patterns on 168 lamps driven by solid angle")
    assert "uneven by 0.50 %" in lines[-1]
    assert "uneven by 14.10 %" in run("binary", "--drive", "on-off")[-1]


def spiral(count):
    """(count, 3) lamps spread over a sphere of a metre."""
    turn, height = np.arange(count) * np.pi * (3 - 5**0.5), 1 - (2 * np.arange(count) + 1) / count
    ring = np.sqrt(1 - height**2)
    return 1000 * np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)


def test_the_evenness_of_each_bank_is_reported_beside_that_of_both(tmp_path):
    places = spiral(40)
    rig = save_rig_with_camera(tmp_path, places)  # banks in turn
    facts = json.loads(run("polarised", "--rig", rig, "--json")[-1])
    normals = spiral(20_000) / 1000
    lamps = places / 1000
    whole = np.clip(normals @ lamps.T, 0, None)
    levels = drive_levels("full", load_rig(rig), "solid-angle")
    for name, bank in (("full@parallel", slice(0, None, 2)), ("full@cross", slice(1, None, 2))):
        light = whole[:, bank] @ levels[bank]
        assert facts["bank_unevenness"][name] == pytest.approx(light.std() / light.mean(), rel=1e-2)
        assert facts["bank_unevenness"][name] > 5 * facts["full_unevenness"]
    last = run("polarised", "--rig", rig)[-1]
    assert f"full@cross by {100 * facts['bank_unevenness']['full@cross']:.2f} %" in last


def test_patterns_in_which_no_lamp_is_lit_are_named(tmp_path):
    places = spiral(40)
    dome = save_rig_with_camera(tmp_path, places[places[:, 2] > 0])
    assert "No lamp is lit in z-: such photographs are dark." in run("binary", "--rig", dome)
    assert json.loads(run("binary", "--rig", dome, "--json")[-1])["unlit"] == ["z-"]
    assert json.loads(run("ambient,polarised", "--json")[-1])["unlit"] == []  # dark is meant to be


def test_lights_on_a_splitting_plane_are_reported(octahedron):
    facts = json.loads(run("x+,lin-y-,mux-1,full", "--rig", octahedron, "--json")[-1])
    assert facts["on_plane"] == {"x": [1, 2, 4, 5], "y": [0, 2, 3, 5], "z": [0, 1, 3, 4]}
    assert [row["on_plane"] for row in facts["patterns"]] == [4, 4, 6, 0]
    printed = [line for line in run("x+", "--rig", octahedron) if line.startswith("On the plane")]
    assert printed[0] == "On the plane x = 0, half in each of a pair: 4 lamps (1, 2, 4, 5)"
    half = json.loads(run("x+@parallel", "--rig", octahedron, "--json")[-1])["patterns"][0]
    assert half["on_plane"] == 2  # lights 2 and 4 are of the vertical bank


def test_mux_states_what_white_lights_cannot():
    assert any("one diagonal" in line for line in run("mux"))
    assert not any("one diagonal" in line for line in run("binary"))


def test_a_sheet_is_drawn(tmp_path):
    lines = run("binary", "--out", tmp_path / "sheet.png")
    assert lines[-1].endswith(f"drawn in {tmp_path / 'sheet.png'}")
    assert cv2.imread(str(tmp_path / "sheet.png")).shape[1] > 1100


def test_ones_own_patterns_are_listed_and_drawn(tmp_path):
    write_exr(tmp_path / "sky.exr", np.ones((8, 16, 3)))
    own = tmp_path / "own.toml"
    own.write_text('[patterns.rim]\nnames = ["arc06/*"]\n[patterns.sky]\nenvironment = "sky.exr"\n')
    facts = json.loads(run("--patterns", own, "--json", "--out", tmp_path / "o.png")[-1])
    assert [row["pattern"] for row in facts["patterns"]] == ["rim", "sky"]
    assert facts["patterns"][0]["lit"] == 14
    assert facts["own"]["sky"]["scale"] > 0
    assert (tmp_path / "o.png").is_file()
    lines = run("full,rim@cross", "--patterns", own)
    assert lines[2].split()[:2] == ["rim@cross", "7"]
    assert "rim, your own, by lights: 14 of 168 lamps" in lines
    assert not any(line.startswith("sky") for line in lines)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nope"], "unknown name"),
        (["full,full"], "twice"),
        (["binary", "--drive", "loud"], "--drive: found 'loud'"),
        (["binary", "--out", "sheet.jpg"], "found suffix '.jpg', expected .png"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(LightstageError, match=message):
        run(*arguments)


def test_a_missing_file_of_patterns_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        run("full", "--patterns", tmp_path / "none.toml")


def test_more_patterns_than_a_sheet_can_show_are_refused(tmp_path):
    from lightstage.patterns.weights import directions

    many = save_rig_with_camera(tmp_path, directions(601) * 1000)
    with pytest.raises(PatternError, match="found 601 patterns, expected at most 600"):
        run("olat", "--rig", many, "--out", tmp_path / "s.png")
    assert len(json.loads(run("olat", "--rig", many, "--json")[-1])["patterns"]) == 601
