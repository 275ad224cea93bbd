"""`lightstage calibrate` as an operator runs it, through the real drivers, and what a capture makes
of it. The cameras are simulated ones."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time

import pytest

from lightstage.calibrations.folder import latest
from lightstage.calibrations.listing import Entry, rigs_of
from lightstage.formats.calibration_shots import read_shots
from lightstage.formats.session import load_session
from lightstage.rig import Rig, default_rig
from lightstage.session import read_journal
from sim.devices.led_device import SETTLE_TIMEOUT_S
from sim.devices.target_stage import TargetStage
from tests.programs import run_program

pytestmark = pytest.mark.usefixtures("forked")

CONFIG = '[calibration]\nwanted = ["chart"]\n'


@pytest.fixture(scope="module")
def rig():
    whole = default_rig().scaled(0.08)
    return Rig(whole.lights, whole.cameras[:2])


@pytest.fixture(scope="module")
def taken(rig, tmp_path_factory):
    """A lab with chart shots, taken by an operator who forgot the chart at first."""
    desk = tmp_path_factory.mktemp("chart")
    with TargetStage(desk / "sim", rig, "chart", 1) as stage:
        stage.swap("nothing")
        asked = stage.calibrate(desk / "lab", "chart", "--json", answers=["", "q"])
        dark_after = stage.device.dark
        stage.swap("chart")
        done = stage.calibrate(desk / "lab", "chart", "--json", "--resume")
        yield stage, desk, asked, done, dark_after


def test_the_target_is_held_toward_each_camera_in_turn(taken, rig):
    stage, _, _, done, _ = taken
    assert done.returncode == 0, done.stderr
    assert stage.photographer.pose == len(rig.cameras) - 1


def capture(stage, desk, out, *more):
    (desk / "config.toml").write_text(CONFIG)
    command = [
        *(sys.executable, "-m", "lightstage", "capture", "--rig", str(stage.rig_path)),
        *("--sequence", "full", "--out", str(out), "--leds", stage.device.url(SETTLE_TIMEOUT_S)),
        *("--cameras", str(stage.cameras_path), "--config", str(desk / "config.toml")),
        *("--unattended", "--calibration", str(desk / "lab"), *more),
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_a_forgotten_target_is_reported_at_once_and_stopped_shots_go_on(taken):
    stage, desk, asked, done, dark_after = taken
    assert asked.returncode == 2
    assert "Traceback" not in asked.stderr
    assert "Pose 1 of 2: Hold the colour chart in the middle of the stage, facing cam0." in (
        asked.stderr
    )
    assert "chart, pose 1, cam0: found no colour chart, expected its 24 patches" in asked.stderr
    last, again = asked.stderr.splitlines()[-2:]
    assert "CaptureError" in last
    assert "found stopped after 0 of 2 poses" in last
    line = shlex.split(again.partition("To resume: ")[2])
    assert line[:5] == ["lightstage", "calibrate", "chart", "--resume", "--rig"]
    assert {"--out", "--leds", "--cameras"} < set(line)
    assert dark_after
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout.splitlines()[-1])
    assert (facts["poses"], facts["now"], facts["again"], facts["accepted"]) == (2, 2, 0, 0)
    assert stage.device.dark
    shots = latest(desk / "lab", "chart")
    assert [pose.folder for pose in shots.file.poses] == ["pose-01.take2", "pose-02"]
    for pose in shots.file.poses:
        session = load_session(shots.root / pose.folder)
        assert session.file.subject == "calibration"
        assert session.file.expression == "chart"
        assert pose.manifest_sha256 is not None
        assert pose.figures[pose.faces]["patches"] == 24
    assert shots.file.devices.cameras["cam1"]["serial"] == stage.rig.cameras[1].serial
    assert shots.changed() == []


def test_a_session_records_the_calibration_shots_that_it_may_use(taken):
    stage, desk, *_ = taken
    done = capture(stage, desk, desk / "S")
    assert done.returncode == 0, done.stderr
    begin = read_journal(desk / "S" / "journal.jsonl")[0]
    fact = begin["facts"]["calibration_shots"]["chart"]
    shots = latest(desk / "lab", "chart")
    assert fact["id"] == shots.file.id
    assert fact["path"] == shots.root.name
    assert fact["sha256"] == shots.sha256
    assert 0 <= fact["age_days"] < 0.1
    assert fact["stale"] == []


def test_a_session_refuses_stale_shots_before_a_light_goes_on_unless_told(taken):
    stage, desk, *_ = taken
    shots = latest(desk / "lab", "chart")
    text = (shots.root / "calibration.json").read_text()
    file = shots.file
    shots.file = file.model_copy(update={"expires_utc": file.created_utc})
    shots.save()
    try:
        before = len(stage.device.states)
        done = capture(stage, desk, desk / "refused")
        assert done.returncode == 2
        assert "calibration chart: found chart-" in done.stderr
        assert "expected at most 0 minutes" in done.stderr
        assert "--allow-stale chart" in done.stderr
        assert not (desk / "refused").exists()
        assert all(not state.counts.any() for state in stage.device.states[before:])
        allowed = capture(stage, desk, desk / "allowed", "--allow-stale", "chart")
        assert allowed.returncode == 0, allowed.stderr
        lines = read_journal(desk / "allowed" / "journal.jsonl")
        assert "old" in lines[0]["facts"]["calibration_shots"]["chart"]["stale"][0]
        warned = [line for line in lines if line["event"] == "finding"]
        assert [line["severity"] for line in warned if "chart" in line["where"]] == ["warn"]
    finally:
        (shots.root / "calibration.json").write_text(text)


def test_killed_within_a_pose_it_goes_on_with_what_it_has(rig, tmp_path):
    with TargetStage(tmp_path / "sim", rig, "grey", 1) as stage:
        lab = tmp_path / "lab"
        command = stage.arguments(lab, "grey", "--unattended", "0", "--poses", "1")
        child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 60
        while len(list(lab.glob("grey-*/pose-01/frames/*/*.dng"))) < 3:
            assert child.poll() is None, child.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.01)
        os.kill(child.pid, signal.SIGKILL)
        child.communicate()
        [folder] = lab.glob("grey-*")
        assert read_shots(folder).file.poses == []
        before = {path: path.read_bytes() for path in folder.rglob("frames/*/cam?.dng")}
        done = stage.calibrate(lab, "grey", "--unattended", "0", "--resume")
        assert done.returncode == 0, done.stderr
        [pose] = read_shots(folder).file.poses
        assert pose.folder == "pose-01"
        assert all(path.read_bytes() == data for path, data in before.items())
        assert len(load_session(folder / "pose-01").file.frames) == 14
        assert stage.device.dark


BAD = {
    "kind": (["ball"], ["kind: found 'ball'", "charuco, mirror, grey, chart, dark, flat"]),
    "every light": (["chart", "--every-light"], ["--every-light: found of chart"]),
    "resume": (["chart", "--resume", "--poses", "3"], ["--resume: found --poses"]),
    "nothing begun": (["chart", "--resume"], ["no such folder", "a lab's folder"]),
    "no poses": (["chart", "--poses", "0"], ["--poses"]),
    "no rig": (["chart", "--rig", "/none/rig.json"], ["/none/rig.json", "no such file"]),
    "config": (["chart", "--config", "CONFIG"], ["days", "weeks", "unknown key"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_exit_2_with_one_message_and_leave_nothing(rig, tmp_path, name):
    more, parts = BAD[name]
    config = tmp_path / "config.toml"
    config.write_text("[calibration.days]\nweeks = 3\n")
    more = [str(config) if each == "CONFIG" else each for each in more]
    with TargetStage(tmp_path / "sim", rig, "dark", 1) as stage:
        done = stage.calibrate(tmp_path / "lab", *more)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    for part in parts:
        assert part in done.stderr
    assert not (tmp_path / "lab").exists()


def test_a_lab_is_listed_by_its_command(taken, tmp_path):
    _, desk, *_ = taken
    done = run_program("lightstage", "calibrations", desk / "lab")
    assert done.code == 0, done.err
    lines = {line.split()[0]: line for line in done.out.splitlines()}
    assert "holds 14 days more" in lines["chart"]
    assert "none yet, wanted by every session" in lines["mirror"]
    assert "1 of 6 kinds hold" in done.out.splitlines()[-1]
    done = run_program("lightstage", "calibrations", tmp_path / "none")
    assert done.code == 2
    assert "found no such folder, expected a lab's folder of calibration shots" in done.err


def test_shots_of_two_rigs_are_distinguished():
    held = [
        Entry(kind, kind, "holds", "", rig) for kind, rig in (("dark", "a" * 64), ("flat", "b"))
    ]
    old = Entry("mirror", "mirror", "expired", "", "c")
    assert rigs_of([held[0], old]) == ""
    assert rigs_of([*held, old]).startswith(
        "taken with 2 files rig.json (dark with aaaaaaaa; flat with b)"
    )
