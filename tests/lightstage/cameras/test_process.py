"""Cameras in processes of their own: none that is dead, stuck or mad keeps the others waiting."""

from __future__ import annotations

import dataclasses
import errno
import math
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.cameras import child, process
from lightstage.cameras.process import CameraProcess, Deadlines
from lightstage.errors import CaptureError, ConfigError, DeviceError

HERE = Path(__file__).parent
NAMES = [f"cam{number}" for number in range(9)]


@pytest.fixture
def camera(monkeypatch, processes, tmp_path):
    """Makes an opened camera with a driver of camera_drivers.py."""
    monkeypatch.setenv("PYTHONPATH", str(HERE))

    def make(kind="Fine", camera_id="cam0", deadlines=20.0):
        port = str(tmp_path / "started") if kind == "Deaf" else camera_id
        made = CameraProcess(camera_id, port, None, deadlines, f"camera_drivers:{kind}")
        processes.append(made)
        made.open()
        return made

    return make


def test_eight_cameras_give_their_photographs_whatever_becomes_of_the_ninth(camera, tmp_path):
    """One stopped, one killed, one whose driver loops for ever: six are not kept waiting."""
    with ThreadPoolExecutor(9) as pool:
        kinds = {"cam2": "Looping"}
        cameras = list(
            pool.map(
                lambda name: camera(kinds.get(name, "Fine"), name, Deadlines(trigger_s=2.0)), NAMES
            )
        )
        os.kill(cameras[4].pid, signal.SIGSTOP)
        os.kill(cameras[7].pid, signal.SIGKILL)
        finished = []

        def take(one):
            try:
                exposure = one.trigger(time.monotonic() + 0.05)
                one.download(exposure.files[0].name, tmp_path / one.id)
                finished.append(one.id)
            except DeviceError as error:
                finished.append(one.id)
                return str(error)
            return "taken"

        text = dict(zip(NAMES, pool.map(take, cameras), strict=True))
    assert "cam2, trigger: found no answer within" in text.pop("cam2")
    assert "cam4, trigger: found no answer within" in text.pop("cam4")
    assert "cam7, trigger: found " in text.pop("cam7")
    assert set(text.values()) == {"taken"}
    assert {finished[-1], finished[-2]} == {"cam2", "cam4"}  # all others came before a deadline
    for name in text:
        assert (tmp_path / name).read_bytes() == name.encode() * 1000


def test_a_driver_that_never_answers_is_killed_at_its_deadline(camera, gone):
    one = camera("Looping", deadlines=Deadlines(trigger_s=0.3))
    pid = one.pid
    with pytest.raises(DeviceError, match="camera cam0, trigger: found no answer within"):
        one.trigger(0.0)
    gone(pid)


def test_what_a_driver_started_ends_with_it(camera, gone):
    """A child of its own that holds the pipe of answers: no end of the stream will tell of it."""
    one = camera("Deaf", deadlines=Deadlines(trigger_s=0.3))
    with pytest.raises(DeviceError, match="camera cam0, trigger: found no answer within"):
        one.trigger(0.0)
    (started,) = (int(line) for line in Path(one.port).read_text().split())
    gone(started)


def test_a_driver_that_fails_is_reported_by_its_last_words_and_can_be_restarted(camera):
    one = camera("Crashing")
    with pytest.raises(DeviceError, match="exit status 1, RuntimeError: a fault in the driver"):
        one.trigger(0.0)
    with pytest.raises(DeviceError, match="its process was ended"):
        one.card()
    assert one.restart().serial == "cam0"
    assert one.card()[0].size == 4000


def test_a_library_that_crashes_takes_its_own_process_alone(camera):
    one = camera("Segfaulting")
    with pytest.raises(DeviceError, match=r"camera cam0, trigger: found .*exit status -11"):
        one.trigger(0.0)
    assert one.restart().serial == "cam0"


def test_each_kind_of_command_has_its_own_deadline(camera, monkeypatch):
    deadlines = Deadlines(
        open_s=11.0, trigger_s=12.0, download_s=13.0, download_bytes_per_s=1000.0, other_s=14.0
    )
    one = camera(deadlines=deadlines)
    asked = {}
    ask = process.Child.ask

    def note(child, command, deadline_s):
        asked[command["command"]] = deadline_s
        return ask(child, command, deadline_s)

    monkeypatch.setattr(process.Child, "ask", note)
    one.summary()
    one.card()
    one.delete("/2.RAW")
    exposure = one.trigger(time.monotonic() + 0.05)
    with pytest.raises(CaptureError):
        one.download(exposure.files[0].name, Path("/nowhere/x"))
    with pytest.raises(DeviceError, match="expected nothing"):
        one.change("iso", "100")
    assert 12.0 < asked.pop("trigger") <= 12.05
    assert asked == {
        "summary": 14.0, "card": 14.0, "delete": 14.0, "change": 14.0, "download": 13.0 + 4.0,
    }  # fmt: skip


@given(st.floats(), st.sampled_from([field.name for field in dataclasses.fields(Deadlines)]))
def test_a_deadline_is_a_finite_time_over_zero_or_refused(value, name):
    if 0 < value < math.inf:
        assert getattr(Deadlines(**{name: value}), name) == value
    else:
        with pytest.raises(ConfigError, match=f"deadlines, {name}: found "):
            Deadlines(**{name: value})


def test_a_computer_that_can_start_no_process_is_reported(camera, monkeypatch):
    one = camera()

    def none_left(*_args, **_more):
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(child.subprocess, "Popen", none_left)
    with pytest.raises(DeviceError, match=r"camera cam0, process: .*out of memory, files"):
        one.open()


def test_no_file_is_left_open_by_cameras_that_come_and_go(camera):
    one = camera()
    one.trigger(0.0)
    open_files = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        one.restart()
        os.kill(one.pid, signal.SIGKILL)
        with pytest.raises(DeviceError):
            one.card()
    one.open()
    assert len(os.listdir("/proc/self/fd")) == open_files


def test_ctrl_c_of_the_terminal_does_not_reach_the_camera_processes(camera):
    pid = camera().pid
    assert os.getpgid(pid) != os.getpgid(0)
    assert os.getsid(pid) != os.getsid(0)


def test_closing_from_another_thread_ends_a_command_that_hangs(camera, monkeypatch):
    monkeypatch.setattr(child, "GRACE_S", 0.2)
    one = camera("Looping", deadlines=60.0)
    lines = []

    def take():
        try:
            one.trigger(0.0)
        except DeviceError as error:
            lines.append(str(error))

    thread = threading.Thread(target=take)
    thread.start()
    one.close()
    thread.join(20)
    assert not thread.is_alive()
    assert "camera cam0, trigger: " in lines[0]
    with pytest.raises(DeviceError, match="not open"):
        one.card()


def test_closing_a_driver_that_hangs_while_it_lets_go_kills_it(camera, gone, monkeypatch):
    monkeypatch.setattr(child, "GRACE_S", 0.2)
    one = camera("HoldingTheLock")
    pid = one.pid
    one.close()
    gone(pid)


def test_a_restart_that_searches_ends_when_the_camera_is_closed(camera):
    one = camera(deadlines=Deadlines(absent_s=60.0))
    one.driver = "camera_drivers:NotThere"
    lines = []

    def restart():
        try:
            one.restart()
        except DeviceError as error:
            lines.append(str(error))

    thread = threading.Thread(target=restart)
    thread.start()
    time.sleep(0.1)
    one.close()
    thread.join(20)
    assert not thread.is_alive()
    assert "closed" in lines[0]
    assert one.pid is None


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        ("no_such_module:Camera", r"driver: found No module named 'no_such_module', expected an"),
        (
            "json:Camera",
            "driver: found module 'json' has no attribute 'Camera', expected an installed module",
        ),
    ],
)
def test_a_driver_that_is_not_there_is_reported_with_the_cameras_name(processes, driver, message):
    one = CameraProcess("cam4", "somewhere", None, 20.0, driver)
    processes.append(one)
    with pytest.raises(DeviceError, match=r"camera cam4 \(somewhere\), " + message):
        one.open()


STEPS = ["triggering", "triggered", "downloading", "downloaded"]


@pytest.mark.parametrize("step", STEPS)
def test_a_process_stops_at_each_named_step_of_its_pattern_and_camera(
    camera, monkeypatch, tmp_path, step, gone
):
    stop = tmp_path / "stop"
    monkeypatch.setenv("LIGHTSTAGE_STOP_FILE", str(stop))
    one = camera(camera_id="cam3")
    path = tmp_path / "photograph"

    def shot(pattern):
        exposure = one.trigger(0.0, pattern)
        one.download(exposure.files[0].name, path, pattern)

    stop.write_text(f"{step} x+ cam3")
    shot("y-")
    path.unlink()
    assert stop.exists()  # another pattern's photograph does not stop
    pid = one.pid
    lines = []

    def killed():
        try:
            shot("x+")
        except DeviceError as error:
            lines.append(str(error))

    thread = threading.Thread(target=killed)
    thread.start()
    until = time.monotonic() + 10
    while (
        f"{pid} (python" in (stated := Path(f"/proc/{pid}/stat").read_text())
        and " T " not in stated
    ):
        assert time.monotonic() < until
        time.sleep(0.005)
    assert not stop.exists()
    half = path.read_bytes() if path.exists() else b""
    assert len(half) == {"downloading": 2000, "downloaded": 4000}.get(step, 0)
    os.kill(pid, signal.SIGKILL)
    thread.join(10)
    assert "exit status -9" in lines[0]
    gone(pid)
