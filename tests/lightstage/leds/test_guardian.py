"""Real captures killed in every way: the device goes dark, and nobody is left behind."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from lightstage.leds import guardian
from lightstage.leds.guard import Guardian, LastWill
from lightstage.leds.opening import open_leds
from sim.devices.adalight_device import AdalightDevice
from sim.devices.icl_server import IclServer
from sim.devices.led_device import WATCHDOG_S, LedDevice
from sim.devices.sacn_device import SOURCE_LOSS_S, SacnDevice
from tests.waiting import until

WATCHFUL = ("pty", "socket", "adalight", "sacn")
KINDS = (*WATCHFUL, "icl")
"""ICL's server has no watchdog: it keeps the last state for ever."""

CAPTURE = """
import signal, subprocess, sys, time
import numpy as np
from lightstage.leds.opening import open_leds
from lightstage.rig import load_rig
from lightstage.safety import SafeLights, SafetyConfig
from pathlib import Path

signal.signal(signal.SIGINT, signal.default_int_handler)
if sys.argv[4] == "handled":
    def interrupt(*_):
        raise KeyboardInterrupt
    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGHUP, interrupt)
rig = load_rig(Path(sys.argv[2]))
config = SafetyConfig(max_silence_s=float(sys.argv[3]))
with open_leds(sys.argv[1], len(rig.lights)) as leds, SafeLights(leds, config, rig) as lights:
    lights.light(np.ones(len(rig.lights)))
    # As camera processes do: it must not keep the pipe to the guardian open.
    quiet = subprocess.DEVNULL
    child = subprocess.Popen(["sleep", "60"], stdout=quiet, stderr=quiet)
    print("lit", lights.guardian_pid, child.pid, flush=True)
    if sys.argv[4] == "storm":
        while True:
            lights._lights.light(np.random.default_rng().random(len(rig.lights)))
    if sys.argv[4] == "fails":
        raise RuntimeError("a bug")
    time.sleep(60)
"""


def unwatched(levels):
    """Nobody looks."""


def far_end(kind):
    if kind == "adalight":
        return AdalightDevice(8, unwatched)
    if kind == "sacn":
        return SacnDevice(8, unwatched)
    if kind == "icl":
        return IclServer(unwatched, at_once=True)
    return LedDevice(8, unwatched, over=kind)


def gone(pid):
    """Whether a process has ended; whoever inherited it may take a second to take note of that."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return True


class Running:
    """A capture in a process and session of its own, with its lights on."""

    def __init__(self, device, rig_path, how="sleeps", silence_s=30.0):
        url = device.url(5.0) if isinstance(device, LedDevice) else device.url("settle_s=0")
        self.device = device
        self.process = subprocess.Popen(
            [sys.executable, "-c", CAPTURE, url, str(rig_path), str(silence_s), how],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        printed = self.process.stdout.readline().split()
        assert printed[:1] == ["lit"], self.process.stderr.read()
        self.guardian, self.child = int(printed[1]), int(printed[2])

    def __enter__(self):
        if self.process.poll() is None:
            until(lambda: len(self.device.states) > 1)
        return self

    def __exit__(self, *_):
        for pid in (self.process.pid, self.child):
            if not gone(pid):
                os.kill(pid, signal.SIGKILL)
        self.process.communicate()


@pytest.fixture
def rig_path(small_rig, tmp_path):
    from lightstage.rig import save_rig

    return save_rig(small_rig, tmp_path / "rig.json")


@pytest.mark.parametrize(("kind", "whole_group"), [*((k, False) for k in KINDS), ("pty", True)])
def test_a_killed_capture_leaves_no_light_on_and_the_device_free(kind, whole_group, rig_path):
    with far_end(kind) as device, Running(device, rig_path) as capture:
        assert not device.dark
        (os.killpg if whole_group else os.kill)(capture.process.pid, signal.SIGKILL)
        until(lambda: device.dark)
        until(lambda: gone(capture.guardian))
        if kind == "sacn":
            assert device.terminated == [1]
        url = device.url(5.0) if isinstance(device, LedDevice) else device.url("")
        with open_leds(url, 8) as leds:
            leds.light(np.ones(8))


def with_watchdog(kind):
    """A far end that goes dark by itself, and the seconds of silence after which it does."""
    if kind == "adalight":
        return AdalightDevice(8, unwatched, timeout_s=1.0), 1.0
    if kind == "sacn":
        return SacnDevice(8, unwatched), SOURCE_LOSS_S
    return LedDevice(8, unwatched, over=kind, watchdog_s=WATCHDOG_S), WATCHDOG_S


@pytest.mark.parametrize("kind", WATCHFUL)
def test_a_capture_killed_with_its_guardian_leaves_the_device_to_go_dark_by_itself(kind, rig_path):
    far, silence_s = with_watchdog(kind)
    with far as device, Running(device, rig_path) as capture:
        both = (capture.process.pid, capture.guardian)
        for number in (signal.SIGSTOP, signal.SIGKILL):  # neither may act on the other's death
            for pid in both:
                os.kill(pid, number)
        capture.process.wait()
        assert device.silences == 0
        until(lambda: device.dark)
        assert device.silences == 1
        assert device.states[-1].at_s - device.heard_s >= silence_s
        assert len(device.states) == 3  # dark, lit, dark


@pytest.mark.parametrize("kind", KINDS)
def test_a_capture_killed_while_it_sends_leaves_no_light_on(kind, rig_path):
    with far_end(kind) as device, Running(device, rig_path, "storm") as capture:
        until(lambda: len(device.states) > 20)
        os.kill(capture.process.pid, signal.SIGKILL)
        until(lambda: gone(capture.guardian))
        until(lambda: device.dark)
        time.sleep(0.05)  # what was still on its way
        assert device.dark


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("how", ["handled", "unhandled"])
def test_a_signal_leaves_no_light_on(number, how, rig_path):
    with far_end("pty") as device, Running(device, rig_path, how) as capture:
        os.kill(capture.process.pid, number)
        until(lambda: device.dark)
        until(lambda: gone(capture.guardian))
        assert capture.process.wait(20) != 0


def test_an_exception_leaves_no_light_on(rig_path):
    with far_end("pty") as device, Running(device, rig_path, "fails") as capture:
        assert capture.process.wait(20) == 1
        until(lambda: device.dark)
        assert "a bug" in capture.process.stderr.read()


@pytest.mark.parametrize("kind", ["pty", "adalight", "icl"])
def test_a_capture_that_stands_still_is_made_dark_from_outside(kind, rig_path):
    with far_end(kind) as device, Running(device, rig_path, silence_s=1.0) as capture:
        os.kill(capture.process.pid, signal.SIGSTOP)
        until(lambda: device.dark)
        until(lambda: gone(capture.guardian))


def test_a_guardian_does_not_mind_signals_of_the_terminal(rig_path):
    with far_end("pty") as device, Running(device, rig_path) as capture:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(capture.guardian, number)
        os.kill(capture.process.pid, signal.SIGKILL)
        until(lambda: device.dark)


def test_a_guardian_that_is_told_goodbye_sends_nothing():
    reading, writing = os.pipe()
    guardian = Guardian(LastWill((writing,), ((b"dark", None),)), 30.0)
    guardian.beat()
    guardian.goodbye()
    assert not guardian.alive
    os.close(writing)
    assert os.read(reading, 10) == b""
    os.close(reading)


def test_a_guardian_sends_its_will_more_than_once_when_nobody_answers():
    reading, writing = os.pipe()
    guardian = Guardian(LastWill((writing,), ((b"dark", None),)), 30.0)
    guardian.leave()
    os.close(writing)
    assert os.read(reading, 100) == 3 * b"dark"
    os.close(reading)


def test_a_will_by_a_connection_of_its_own_is_sent_until_it_is_the_last_word():
    ours, device = socket.socketpair()
    heard = []

    def serve(listener):
        """A server that reads on in the capture's connection only after the first will."""
        while True:
            line, _ = listener.accept()
            with line:
                heard.append(line.recv(100))
                line.sendall(b"HTTP/1.1 101\r\n\r\n")
                heard.append(line.recv(100))
                line.sendall(b"is dark")
            if len(heard) == 2:
                heard.append(device.recv(100))
                device.close()

    ours.sendall(b"light")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, args=(listener,), daemon=True).start()
        will = {
            "handle": ours.fileno(), "messages": [[b"dark".hex(), None]], "patience_s": 20.0,
            "answer": b"is dark".hex(), "connect": listener.getsockname(), "greeting": b"GET".hex(),
        }  # fmt: skip
        assert guardian.make_dark_anew(will)
    assert heard[:3] == [b"GET", b"dark", b"light"]
    assert heard[-2:] == [b"GET", b"dark"]
    ours.close()


def test_a_will_that_nobody_takes_is_given_up_and_reported():
    ours, device = socket.socketpair()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = listener.getsockname()
    will = {
        "handle": ours.fileno(), "messages": [[b"dark".hex(), None]], "patience_s": 0.1,
        "answer": b"is dark".hex(), "connect": place, "greeting": b"GET".hex(),
    }  # fmt: skip
    assert not guardian.make_dark_anew(will)
    ours.close()
    device.close()


def test_a_guardian_whose_capture_died_before_it_was_ready_makes_the_device_dark_without_a_word():
    ours, device = socket.socketpair()
    reader, writer = os.pipe()
    os.close(reader)  # the capture that would read "ready" is gone
    will = {
        "handle": ours.fileno(), "messages": [[b"dark".hex(), None]], "answer": b"is dark".hex(),
        "patience_s": 20.0, "silence_s": 20.0,
    }  # fmt: skip
    child = subprocess.Popen(
        [sys.executable, "-I", "-S", guardian.__file__],
        stdin=subprocess.PIPE, stdout=writer, stderr=subprocess.PIPE, pass_fds=[ours.fileno()],
    )  # fmt: skip
    os.close(writer)
    child.stdin.write(json.dumps(will).encode() + b"\n")
    child.stdin.close()
    assert device.recv(4) == b"dark"
    device.send(b"is dark")
    assert child.wait(20) == 0
    assert child.stderr.read() == b""
