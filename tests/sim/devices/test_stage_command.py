"""`lightstage-sim stage`: a stage that stands ready, captured by hand as the command says."""

import io
import itertools
import shlex
import signal
import subprocess
import sys

import pytest

from lightstage.formats.landmarks import read_points_px
from lightstage.formats.session import load_session
from lightstage.rig import save_rig
from sim.devices.stage_command import Echo
from tests.programs import run_program

pytestmark = pytest.mark.usefixtures("forked")


def test_the_command_that_a_standing_stage_prints_captures_it(tmp_path, tiny_rig):
    rig = save_rig(tiny_rig, tmp_path / "rig.json")
    options = ["--rig", str(rig), "--scale", "1", "--sequence", "full,x+"]
    options += ["--landmarks", "clicked.json"]
    stage = subprocess.Popen(
        [sys.executable, "-m", "sim", "stage", *options],
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    try:
        lines = iter(stage.stdout.readline, "")
        begun = itertools.dropwhile(lambda line: "lightstage capture" not in line, lines)
        command = list(itertools.takewhile(str.strip, begun))
        assert max(map(len, command)) < 200  # no path is broken where it is copied
        arguments = shlex.split("".join(command).replace("\\\n", ""))[1:]
        done = subprocess.run(
            [sys.executable, "-m", "lightstage", *arguments],
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        assert done.returncode == 0, done.stderr
        assert "cp clicked.json SESSION/landmarks.json" in next(lines)
        assert set(read_points_px(tmp_path / "clicked.json")) == {c.id for c in tiny_rig.cameras}
        assert len(load_session(tmp_path / "SESSION").file.frames) == 2 * len(tiny_rig.cameras)
    finally:
        stage.send_signal(signal.SIGINT)
        assert stage.wait(30) == 0


def test_a_simulated_target_becomes_calibration_shots_that_hold(tmp_path, tiny_rig):
    rig = save_rig(tiny_rig, tmp_path / "rig.json")
    options = ["dark", "--out", str(tmp_path / "LAB"), "--rig", str(rig), "--scale", "1"]
    options += ["--rewired", "3"]
    done = run_program("sim", "calibrate", *options)
    assert done.code == 0, done.err
    listed = run_program("lightstage", "calibrations", tmp_path / "LAB")
    assert "1 of 6 kinds hold" in listed.out


def test_lines_that_go_on_with_devices_that_are_gone_are_not_passed_on():
    file = io.StringIO()
    echo = Echo(file)
    text = "Pose 1 of 2: \n  To resume: lightstage calibrate x\n  Get it\nq stops: "
    for letter in text:
        echo(letter)
    assert file.getvalue() == "Pose 1 of 2: \n  Get it\nq stops: "


def test_a_target_too_small_in_the_pictures_is_one_error_and_what_to_do(tmp_path, tiny_rig):
    rig = save_rig(tiny_rig, tmp_path / "rig.json")
    options = ["chart", "--out", str(tmp_path / "LAB"), "--rig", str(rig), "--scale", "1"]
    done = run_program("sim", "calibrate", *options)
    assert done.code == 2
    assert done.err.count("Error: ") == 1
    assert "To resume" not in done.err
    assert "at a larger --scale if the target is too small" in done.err
    assert "pose 1 was not usable in 6 takes" in done.err
