"""`lightstage capture` as a user runs it: a device on a pty, real virtual cameras, real signals."""

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from lightstage.commands.app import INTERRUPTED
from lightstage.formats.files import sha256_file, write_json
from lightstage.formats.session import load_session
from lightstage.rig import Rig, rig_to_json, save_rig

pytestmark = pytest.mark.usefixtures("forked")


def arguments(stage, out, *more):
    return [
        *(sys.executable, "-m", "lightstage", "capture", "--rig", str(stage.rig_path)),
        *("--out", str(out), "--leds", stage.device.url, "--cameras", str(stage.cameras_path)),
        *more,
    ]


def run(stage, out, *more):
    return subprocess.run(arguments(stage, out, *more), capture_output=True, text=True, timeout=120)


@pytest.fixture
def run_here(run_command):
    """As `run`, in this process: for what is refused before a device is opened."""

    def run(stage, out, *more):
        words = arguments(stage, out, *more)
        ended = run_command("lightstage", *words[3:])
        return subprocess.CompletedProcess(words, ended.code, ended.out, ended.err)

    return run


def quickly(tmp_path):
    """Options of a capture whose light changes as fast as it can: nobody sits in the stage."""
    config = tmp_path / "quick.toml"
    config.write_text("[safety]\nlight_interval_s = 0.0\nmax_flashes_per_s = 30.0\n")
    return "--config", str(config)


def one_clear_message(done, *parts):
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    for part in parts:
        assert part in done.stderr, done.stderr


def test_every_photograph_is_the_one_that_the_acknowledged_light_gave(stage, tmp_path):
    out = tmp_path / "S"
    colour = {"schema": "lightstage.colour/1", "cameras": {}}
    for camera in stage.rig.cameras:
        colour["cameras"][camera.id] = {"linear_from_raw": np.eye(3).tolist()}
    write_json(tmp_path / "colour.json", colour)
    words = ["--json", "--subject", "p7", "--colour", str(tmp_path / "colour.json")]
    done = run(stage, out, *words, *quickly(tmp_path))
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout.splitlines()[-1])
    assert facts["frames"] == 21
    assert stage.device.dark
    session = load_session(out)
    assert session.file.subject == "p7"
    assert session.file.calibration.colour == "calibration/colour.json"
    for frame in session.file.frames:
        index = int(frame.camera[-1])
        data = session.frame_path(frame).read_bytes()
        assert data == stage.shown(session.levels(frame.pattern), index)
        assert frame.path == f"frames/{frame.pattern}/{frame.camera}.dng"
        assert frame.sha256 == sha256_file(session.frame_path(frame))
    checked = subprocess.run(
        [sys.executable, "-m", "lightstage", "check", str(out)], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stderr
    assert "21 photographs whole and unchanged, 9 pattern sums" in checked.stdout
    assert list(out.rglob(".*")) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_dark_with_whole_files_however_often_it_comes(stage, tmp_path, number):
    out = tmp_path / "S"
    child = subprocess.Popen(
        arguments(stage, out), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while not list(out.glob("frames/x+/cam*.dng")):
        assert child.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    for _ in range(4):  # a second Ctrl-C must not lose what the first one has to say
        child.send_signal(number)
        time.sleep(0.1)
    _, printed = child.communicate(timeout=60)
    assert child.returncode == INTERRUPTED
    assert "Traceback" not in printed
    assert printed.count("STOPPING") == 1
    assert json.loads((out / "journal.jsonl").read_text().splitlines()[-1])["event"] == "aborted"
    assert "Stopped by the operator.\n  To resume: lightstage capture --resume --out" in printed
    assert "Error" not in printed
    assert stage.device.dark
    assert not (out / "session.json").exists()
    assert list(out.rglob(".*")) == []
    for line in (out / "journal.jsonl").read_text().splitlines():
        event = json.loads(line)
        if event["event"] == "frame":
            assert sha256_file(out / event["path"]) == event["sha256"]


def test_a_camera_whose_picture_is_gone_is_named_and_the_others_are_kept(stage, tmp_path):
    gone = stage.seeds[1]
    show = stage.device.on_state

    def show_and_lose(levels):
        show(levels)
        if 0 < levels.mean() < 1:
            gone.unlink(missing_ok=True)

    stage.device.on_state = show_and_lose
    out = tmp_path / "S"
    done = run(stage, out, "--sequence", "full,x+,x-", *quickly(tmp_path))
    one_clear_message(
        done,
        "x+ by cam1",
        "the camera could not take the photograph",
        f"lightstage capture --resume --out {out}",
    )
    assert stage.device.dark
    assert len(list(out.glob("frames/*/*.dng"))) == 5
    assert not (out / "session.json").exists()


def test_lights_on_a_splitting_plane_are_reported_and_lit_by_half(stage, tmp_path):
    rig = stage.rig
    moved = dataclasses.replace(rig.lights[3], position_mm=(0.0, 700.0, 700.0))
    rig = Rig((*rig.lights[:3], moved, *rig.lights[4:]), rig.cameras)
    stage.rig = rig
    save_rig(rig, stage.rig_path)
    out = tmp_path / "S"
    words = ["--sequence", "full,x+,x-", "--drive", "on-off"]
    done = run(stage, out, *words, *quickly(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "1 lamp on the splitting plane (ids 3)" in done.stderr
    session = load_session(out)
    halves = [session.levels(pattern)[3] for pattern in ("x+", "x-")]
    assert sum(halves) == 1.0
    assert np.allclose(halves, 0.5, atol=1e-4)


def test_a_device_that_falls_silent_ends_the_capture(stage, tmp_path):
    stage.device.dead_after = 4  # HELLO?, DARK, SET, one STATE? are answered, nothing after
    stage.device.url = stage.device.url.replace("timeout_s=5", "timeout_s=0.2&attempts=2")
    done = run(stage, tmp_path / "S")
    one_clear_message(done, "no answer to 5 HELLO?", "The lights may still be on")


def test_cameras_that_are_missing_unknown_or_mute_are_all_reported_before_a_light_goes_on(
    stage, tmp_path
):
    text = stage.cameras_path.read_text().replace('"iso", ', "")
    stage.cameras_path.write_text(text)
    shutil.rmtree(stage.seeds[2].parents[2])
    done = run(stage, tmp_path / "S")
    one_clear_message(done, "3 problems", "camera cam0, iso", "camera cam1, iso", "camera cam2")
    assert not (tmp_path / "S").exists()
    assert all(not state.any() for state in stage.device.states)


BAD = {
    "pattern": (["--sequence", "full,z*"], ["pattern 'z*'", "an unknown name", "olat-NNN"]),
    "olat": (["--sequence", "olat-999"], ["olat-999", "no lamp of this id"]),
    "twice": (["--sequence", "full,full"], ["pattern 'full'", "twice"]),
    "nothing": (["--sequence", ","], ["no pattern"]),
    "subject": (["--subject", "a@b.org"], ["--subject", "a@b.org", "pseudonym"]),
    "path": (["--subject", "../x"], ["--subject", "../x"]),
    "url": (["--leds", "ftp://x"], ["--leds", "ftp://x", "serial:///dev"]),
    "no device": (["--leds", "serial:///dev/null-none"], ["LED device", "a port that opens"]),
    "no rig": (["--rig", "/none/rig.json"], ["/none/rig.json", "no such file"]),
    "no cameras file": (
        ["--cameras", "/none/c.toml"],
        ["/none/c.toml", "no such file", "by their serial numbers"],
    ),
    "no colour": (["--colour", "/none/colour.json"], ["/none/colour.json", "no such file"]),
    "nothing that may be stale": (["--allow-stale", "chart"], ["--allow-stale", "--calibration"]),
    "unknown option": (["--sequense", "full"], ["--sequense"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_exit_2_with_one_message_and_leave_nothing(stage, tmp_path, run_here, name):
    more, parts = BAD[name]
    done = run_here(stage, tmp_path / "S", *more)
    one_clear_message(done, *parts)
    assert not (tmp_path / "S").exists()
    assert stage.device.kinds == []


def test_a_bad_rig_exits_2_with_every_fault(stage, tmp_path, run_here):
    value = rig_to_json(stage.rig)
    value["lights"][1]["id"] = 0
    value["lights"][2]["position_mm"] = [0, 0, 0]
    write_json(stage.rig_path, value)
    done = run_here(stage, tmp_path / "S")
    one_clear_message(done, "2 problems", "an id that corner0 has too", "from the origin")
    assert not (tmp_path / "S").exists()


def test_an_unknown_configuration_key_exits_2(stage, tmp_path, run_here):
    config = tmp_path / "config.toml"
    config.write_text("[safety]\nmax_flashes = 9\n")
    done = run_here(stage, tmp_path / "S", "--config", str(config))
    one_clear_message(done, str(config), "max_flashes", "unknown key", "max_flashes_per_s")
    assert not (tmp_path / "S").exists()


def test_a_sequence_that_flashes_too_fast_or_burns_too_long_is_refused(stage, tmp_path, run_here):
    config = tmp_path / "config.toml"
    config.write_text("[safety]\nlight_interval_s = 0.1\nmax_light_on_s = 60\n")
    done = run_here(stage, tmp_path / "S", "--config", str(config))
    one_clear_message(done, "up to 4 flashes per second", "at most 3", "lamps over the budget")
    assert stage.device.kinds == []


def test_limits_that_are_none_are_refused_with_their_file_before_a_device_is_opened(
    stage, tmp_path, run_here
):
    config = tmp_path / "config.toml"
    config.write_text("[safety]\nmax_flashes_per_s = 1e6\nmax_silence_s = 1000\n")
    done = run_here(stage, tmp_path / "S", "--config", str(config))
    one_clear_message(
        done, str(config), "max_flashes_per_s: found 1e+06, expected a number from 0.5 to 30",
        "max_silence_s: found 1000",
    )  # fmt: skip
    assert stage.device.kinds == []
    assert not (tmp_path / "S").exists()


def test_a_limit_above_three_flashes_is_warned_of_at_the_start_in_the_facts_and_the_journal(
    stage, tmp_path
):
    config = tmp_path / "config.toml"
    config.write_text("[safety]\nmax_flashes_per_s = 10\n")
    out = tmp_path / "S"
    done = run(stage, out, "--json", "--sequence", "full", "--config", str(config))
    assert done.returncode == 0, done.stderr
    assert "seizures" in done.stderr
    facts = json.loads(done.stdout.splitlines()[-1])
    assert facts["safety"]["max_flashes_per_s"] == 10
    (stated,) = facts["photosensitivity"]
    assert "10 flashes per second allowed" in stated
    lines = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    kinds = [line.get("code", line["event"]) for line in lines]
    assert kinds.index("photosensitivity") < kinds.index("lit")
    assert json.loads((out / "manifest.json").read_text())["warnings"]["photosensitivity"] == 1


def test_another_stages_rig_is_refused_before_a_light_goes_on(stage, tmp_path):
    save_rig(type(stage.rig)(stage.rig.lights[:-1], stage.rig.cameras), stage.rig_path)
    done = run(stage, tmp_path / "S")
    one_clear_message(done, "lamp count", "found 8", "expected 7")
    assert not (tmp_path / "S").exists()


def test_an_existing_session_is_never_touched(stage, tmp_path, run_here):
    out = tmp_path / "S"
    out.mkdir()
    (out / "mine.txt").write_text("kept")
    done = run_here(stage, out)
    one_clear_message(done, "something there already", "a new folder")
    assert os.listdir(out) == ["mine.txt"]
