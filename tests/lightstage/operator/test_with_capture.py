"""`lightstage capture` at a terminal: real keys, real virtual cameras, a device on a pty."""

import json
import re
import shlex
import subprocess
import sys
import threading

import pytest

from lightstage.commands.app import INTERRUPTED
from lightstage.formats.session import load_session
from lightstage.operator.client import ask, follow
from lightstage.resume_line import resume_line

pytestmark = pytest.mark.usefixtures("forked")

PATTERNS = ["full", "x+", "x-", "y+"]
SEQUENCE = ("--sequence", ",".join(PATTERNS))


@pytest.fixture
def capture(stage, tmp_path, terminals, runtime):
    """Starts a capture of the small stage at a terminal."""
    out = tmp_path / "it's a (new) $HOME & S"

    def start(*more):
        what = ["--resume"] if "--resume" in more else ["--rig", str(stage.rig_path)]
        more = [each for each in more if each != "--resume"]
        where = ["--out", out, "--leds", stage.device.url, "--cameras", stage.cameras_path]
        arguments = [*what, *map(str, where), *more]
        terminal = terminals("-m", "lightstage", "capture", *arguments)
        return terminal, out

    return start


def events(out, *kinds):
    journal = out / "journal.jsonl"
    if not journal.exists():
        return []
    lines = [json.loads(raw) for raw in journal.read_bytes().split(b"\n")[:-1]]
    return [line for line in lines if line["event"] in kinds]


def test_after_q_no_light_goes_on_and_the_advised_line_goes_on(stage, capture, terminals):
    terminal, out = capture(*SEQUENCE)
    terminal.wait_until(lambda: len(events(out, "shot")) == 2, "no two shots")
    terminal.press("q")
    assert terminal.end() == INTERRUPTED
    assert stage.device.dark
    assert terminal.mode() == terminal.before
    terminal.wait_for("STOPPING: lights out")
    terminal.wait_for("Stopped by the operator.")
    assert "Error" not in terminal.output
    advised = re.findall(r"To resume: (lightstage capture --resume[^\r\n]*)", terminal.output)[-1]
    assert len(events(out, "aborted")) == 1
    assert not (out / "session.json").exists()
    kept = len(events(out, "frame"))
    assert kept >= 6

    program, *words = shlex.split(advised)
    # A resumed capture is stopped as the first was.
    lit, states = len(events(out, "lit")), len(stage.device.states)
    again = terminals("-m", program, *words)
    again.wait_until(lambda: len(events(out, "lit")) > lit, "no light after the resume")
    again.press("q")
    assert again.end() == INTERRUPTED, again.output[-3000:]
    # No light went on after q.
    shone = [bool(state.any()) for state in stage.device.states[states:]]
    assert sum(shone) == 1
    assert not shone[-1]
    assert len(events(out, "aborted")) == 2
    again = terminals("-m", program, *words)
    assert again.end() == 0, again.output[-3000:]
    again.wait_for("12 of 12 photographs, COMPLETE")
    session = load_session(out)
    assert [frame.pattern for frame in session.file.frames][::3] == PATTERNS
    assert stage.device.dark


def test_a_failed_camera_is_asked_about_and_taken_again_alone(stage, capture):
    gone, show = stage.seeds[1], stage.device.on_state
    away = gone.with_name("away")

    def show_and_lose(levels):
        show(levels)
        if len(stage.device.states) > 2 and not away.exists() and levels.any():
            gone.rename(away)

    stage.device.on_state = show_and_lose
    terminal, out = capture("--sequence", "full,x+,x-")
    terminal.wait_for("What now?")
    terminal.wait_for("check its cable, battery and card")
    assert "accept as it is" not in terminal.output
    stage.device.on_state = show
    away.rename(gone)
    terminal.press("r")
    assert terminal.end() == 0, terminal.output[-3000:]
    failed = events(out, "finding")
    assert {line["camera"] for line in failed if line["code"] == "not-taken"} == {"cam1"}
    takes = {(line["pattern"], line["camera"]): line["take"] for line in events(out, "frame")}
    assert len(takes) == 9
    assert len(events(out, "frame")) == 9  # the others were not taken again
    assert stage.device.dark


def test_pause_is_dark_and_goes_on(stage, capture):
    terminal, out = capture("--sequence", "full,x+,x-")
    terminal.wait_until(lambda: len(events(out, "lit")) == 1, "no light")
    terminal.press("p")
    terminal.wait_for("DARK (paused)")
    assert stage.device.dark
    count = len(events(out, "frame"))
    assert count < 9
    terminal.press("c")
    assert terminal.end() == 0, terminal.output[-3000:]
    assert len(events(out, "frame")) == 9


def test_others_follow_every_line_and_may_stop_it(stage, capture):
    terminal, out = capture(*SEQUENCE)
    terminal.wait_until(lambda: events(out, "shot"), "no shot")
    got = []
    follower = threading.Thread(target=lambda: got.extend(follow(out)))
    follower.start()
    assert ask(out, "abort") is None
    assert terminal.end() == INTERRUPTED
    follower.join(60)
    journal = [json.loads(raw) for raw in (out / "journal.jsonl").read_bytes().splitlines()]
    assert got == journal
    assert got[-1]["event"] == "aborted"
    assert stage.device.dark


@pytest.mark.parametrize("moment", ["before-the-first-frame", "in-the-middle", "in-a-question"])
def test_who_watches_a_capture_that_is_killed_is_reported_with_the_line_that_goes_on(
    stage, capture, terminals, moment
):
    if moment == "in-a-question":
        stage.seeds[1].rename(stage.seeds[1].with_name("away"))
    terminal, out = capture(*SEQUENCE)
    watcher = terminals("-m", "lightstage", "watch", str(out))
    wanted = {"before-the-first-frame": "lit", "in-the-middle": "shot", "in-a-question": "asked"}
    terminal.wait_until(lambda: events(out, wanted[moment]), "it does not come to it")
    if moment != "before-the-first-frame":
        watcher.wait_for("leave (the capture continues)")
    terminal.process.kill()
    later = terminals("-m", "lightstage", "watch", str(out))
    (begin,) = events(out, "begin")
    for each in (watcher, later):
        assert each.end() == 0, each.output[-3000:]
        each.wait_for(f"To resume: {resume_line(out, begin['resume_with'])}")
        left = "\n".join(each.emulator.history)
        assert "and no capture runs" in left
        assert "\nNO CAPTURE RUNS\n" in left
        assert "leave (the capture continues)" not in left


def test_a_log_of_a_capture_has_plain_lines(stage, tmp_path, runtime):
    out = tmp_path / "S"
    done = subprocess.run(
        [
            *(sys.executable, "-m", "lightstage", "capture", "--rig", str(stage.rig_path)),
            *("--out", str(out), "--leds", stage.device.url),
            *("--cameras", str(stage.cameras_path), "--sequence", "full,x+,x-"),
        ],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stderr
    assert "+ x- done. 9 of 9 photographs" in done.stderr
    assert f"lightstage watch {out}" in done.stderr
    assert list(runtime.glob("*.sock")) == []
