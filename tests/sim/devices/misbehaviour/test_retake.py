"""`lightstage retake`: any photograph of a session taken again; the earlier takes stay."""

from __future__ import annotations

import hashlib
import json

import pytest
from typer.testing import CliRunner

from lightstage.__main__ import app
from lightstage.capture import unfinished
from lightstage.capture.retake_command import order_retake
from lightstage.checks import check_session
from lightstage.errors import ConfigError, FormatError
from lightstage.formats.session import load_session
from lightstage.session import read_journal
from sim.devices.faults import Fault


def again(standing, root, patterns, *cameras):
    _, order = order_retake(root, patterns, cameras)
    return standing.capture(root, order=order)


def frames(root):
    return {(f.pattern, f.camera): f.path for f in load_session(root).file.frames}


def test_a_photograph_of_a_finished_session_is_taken_again_and_the_earlier_take_stays(stage):
    with stage.standing() as standing:
        root = standing.capture().root
        first = (root / "frames/full/cam1.dng").read_bytes()
        before = frames(root)
        ending = again(standing, root, ["full"], "cam1")
        assert ending.message == ""
        assert (ending.report.taken, ending.report.retakes) == (1, 1)
    assert (root / "frames/full/cam1.dng").read_bytes() == first
    assert frames(root) == before | {("full", "cam1"): "frames/full/cam1.take2.dng"}
    manifest = json.loads((root / "manifest.json").read_text())
    assert {"frames/full/cam1.dng", "frames/full/cam1.take2.dng"} <= set(
        manifest["files"] | manifest.get("superseded", {})
    )
    (line,) = ending.lines("retake")
    assert line["takes"] == [["full", "cam1", 1]]
    assert read_journal(root / "journal.jsonl")[-1]["event"] == "end"
    assert ending.fine
    assert check_session(root).frames == 9


def test_what_others_left_on_the_cards_since_does_not_enter_a_session_that_was_finished(stage):
    with stage.standing() as standing:
        root = standing.capture().root
        other = standing.capture().root
        ending = again(standing, root, ["x+", "x-"], "cam0")
        assert ending.message == ""
    theirs = {hashlib.sha256(p.read_bytes()).hexdigest() for p in other.glob("frames/*/*.dng")}
    ours = {hashlib.sha256(p.read_bytes()).hexdigest() for p in root.rglob("*.dng")}
    assert len(theirs) == 9
    assert not theirs & ours
    assert ending.recovered() == []


def test_an_unfinished_session_does_not_take_in_what_another_session_left_on_the_cards(stage):
    with stage.standing(Fault("fail", camera="cam2", at=2, until=4)) as standing:
        first = standing.capture()
        assert "x+ by cam2" in first.message
        other = standing.capture()
        assert other.message == ""
        ending = again(standing, first.root, ["full"], "cam0")
        assert ending.message == ""
    assert len(other.kept()) == 9
    assert ending.recovered() == []
    assert frames(first.root)["full", "cam0"] == "frames/full/cam0.take2.dng"
    assert len(frames(first.root)) == 9


def test_a_retake_that_was_cut_short_goes_on_by_resume(stage):
    with stage.standing(Fault("battery-empty", camera="cam1", at=4)) as standing:
        root = standing.capture().root
        ending = again(standing, root, ["full"], "cam1")
        assert "its battery is empty" in ending.message
        with pytest.raises(FormatError, match="capture --resume"):
            check_session(root)
        state = standing.coded.cameras.folder("cam1") / "state.json"
        state.write_text(json.dumps(json.loads(state.read_text()) | {"off": False}))
        ending = standing.capture(root, order=unfinished(root)[1])
        assert ending.message == ""
    assert frames(root)["full", "cam1"] != "frames/full/cam1.dng"
    assert (root / "frames/full/cam1.dng").is_file()
    assert ending.fine


def test_what_a_session_does_not_have_is_one_message(stage, tmp_path):
    root = stage.capture().root
    with pytest.raises(ConfigError) as caught:
        order_retake(root, ["full", "sideways"], ["cam0", "cam9"])
    assert "pattern 'sideways'" in str(caught.value)
    assert "camera 'cam9'" in str(caught.value)
    assert "expected full, x+, x-" in str(caught.value)
    assert "cameras after them have blanks: x+,x- cam0 cam1" in str(caught.value)
    with pytest.raises(FormatError, match="no such folder, expected the folder of a session"):
        order_retake(tmp_path / "nowhere", ["full"], [])
    done = CliRunner().invoke(app, ["retake", str(root), "full", "cam9", "--leds", "socket://x:1"])
    assert isinstance(done.exception, ConfigError)
