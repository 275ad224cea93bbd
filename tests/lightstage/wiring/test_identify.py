"""`lightstage lights identify`: one lamp at a time, addresses corrected by what is seen."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import DeviceError
from lightstage.rig import load_rig, save_rig
from lightstage.safety import SafetyConfig
from lightstage.wiring.identify import identify
from lightstage.wiring.walk import Walk, place_in_words
from sim.devices.faults import Fault, Story
from sim.devices.led_device import LedDevice
from sim.devices.wiring import Wires, shuffled_wires
from tests.lightstage.conftest import make_rig

QUICK = SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0)


class Lamps:
    """Lamps on the wires of a device; whoever looks sees which shine."""

    def __init__(self, wires: np.ndarray, **more) -> None:
        self.states: list[list[int]] = []
        line = Wires(wires)
        self.device = LedDevice(line.count, line.show(self._see), **more)

    def _see(self, levels: np.ndarray) -> None:
        self.states.append([int(i) for i in np.flatnonzero(levels)])

    @property
    def shining(self) -> list[int]:
        return self.states[-1] if self.states else []


def test_an_operator_who_says_what_shines_finds_every_address():
    rig = make_rig()
    wires = shuffled_wires(rig, 3)
    lamps = Lamps(wires)
    right: set[int] = set()
    lines: list[str] = []

    def ask(_: str) -> str:
        meant = int(re.findall(r"^Light (\d+)", lines[-1])[0])
        (shining,) = lamps.shining
        if shining == meant:
            right.add(meant)
            return "q" if len(right) == 8 else "n"
        return f"s {shining}"

    saved = []
    with lamps.device as device:
        found = identify(
            rig, device.url(20.0), ask, told_lights(lines), saved.append, QUICK, level=0.5
        )
        assert device.dark
    assert [address.channel for address in found.addresses] == wires.tolist()
    assert saved[-1] is found
    for each in saved:
        assert sorted(address.channel for address in each.addresses) == list(range(8))
    assert max(map(len, lamps.states)) == 1
    assert lines[0] == (
        "Light 0 (corner0), 1 of 8: 135 degrees to the left (behind the person), 35 degrees down; "
        "channel 0 of main"
    )


def told_lights(told):
    """Keeps the lines that tell a light."""
    return lambda line: told.append(line) if re.match(r"Light \d+ \(\w+\), ", line) else None


def test_a_channel_of_the_device_that_no_light_has_can_be_given():
    wires = np.arange(8)
    wires[2] = 11
    lamps, answers, stated = Lamps(wires), iter(["2", "c 11", "d", "c 99", "q"]), []
    with lamps.device as device:
        found = identify(
            make_rig(), device.url(20.0), lambda _: next(answers), stated.append,
            lambda _: None, QUICK, 1.0,
        )  # fmt: skip
    assert [address.channel for address in found.addresses] == wires.tolist()
    # Light 2's wire was free: its channel of before lights nothing.
    assert [state for state in lamps.states if state] == [[0], [2]]
    assert "No channel 99: there are 12, counted from 0." in stated


def test_a_device_of_fewer_channels_than_the_rig_is_refused_before_a_light_goes_on():
    lamps = Lamps(np.arange(6))
    with lamps.device as device, pytest.raises(DeviceError, match="found 6, expected at least 8"):
        identify(make_rig(), device.url(20.0), input, print, print, QUICK, 1.0)
    assert lamps.states == []


@pytest.mark.parametrize(("packet", "while_seen"), [(5, False), (6, True)])
def test_a_device_that_was_reset_lights_the_next_lamp_again(packet, while_seen):
    lines: list[str] = []
    answers = iter(["", "", "", "q"])
    lamps = Lamps(np.arange(8), story=Story([Fault("reset", at=packet, seconds=0.0)]))
    with lamps.device as device:
        identify(
            make_rig(), device.url(0.3), lambda _: next(answers), lines.append,
            lambda _: None, QUICK, 1.0,
        )  # fmt: skip
        assert device.dark
        assert device.log.names() == ["reset"]
    assert any("The light was lost" in line for line in lines) == while_seen
    assert [state for state in lamps.states if state] == [[0], [1], [2], [3]]


@given(st.lists(st.text(st.sampled_from("nbcsdq0123456789 \t?x"), max_size=6), max_size=30))
def test_whatever_is_typed_no_channel_is_ever_given_twice(lines):
    rig = make_rig()
    walk = Walk(rig, 10)
    for line in lines:
        walk.hear(line)
        assert len(set(walk.channels)) == 8
        assert max(walk.channels) < 10
        assert 0 <= walk.at < 8
    assert walk.over == any(re.fullmatch(r"\s*q\s*", line) for line in lines)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ((0, 0, 9), "straight ahead, 0 degrees up"),
        ((9, 0, 0), "90 degrees to the right, 0 degrees up"),
        ((-9, 9, 0), "90 degrees to the left, 45 degrees up"),
        ((-9, -9, -9), "135 degrees to the left (behind the person), 35 degrees down"),
    ],
)
def test_a_place_is_told_as_the_frontal_camera_sees_it(place, words):
    assert place_in_words(np.array(place, float)) == words


def command(folder, device, *more):
    return [
        *(sys.executable, "-m", "lightstage", "lights", "identify"),
        *("--rig", str(folder / "rig.json"), "--out", str(folder / "new.json")),
        *("--leds", device.url(20.0), *more),
    ]


def test_lines_from_a_pipe_correct_the_rig(tmp_path):
    save_rig(make_rig(), tmp_path / "rig.json")
    lamps = Lamps(np.array([1, 0, 2, 3, 4, 5, 6, 7]))
    with lamps.device as device:
        done = subprocess.run(
            command(tmp_path, device, "--json"),
            input="0\ns 1\n",
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        assert device.dark
    assert [a.channel for a in load_rig(tmp_path / "new.json").addresses][:3] == [1, 0, 2]
    facts = json.loads(done.stdout.splitlines()[-1])
    assert facts["corrected"] == [
        "light 0 (corner0): channel 0 -> 1",
        "light 1 (corner1): channel 1 -> 0",
    ]
    assert lamps.states[-2:] == [[0], []]


def test_without_a_terminal_and_a_line_it_is_refused_in_one_message(tmp_path):
    save_rig(make_rig(), tmp_path / "rig.json")
    lamps = Lamps(np.arange(8))
    with lamps.device as device:
        done = subprocess.run(
            command(tmp_path, device), stdin=subprocess.DEVNULL, capture_output=True, text=True
        )
    assert done.returncode == 2
    assert done.stderr.startswith("ConfigError: standard input: found no terminal and no line")
    assert done.stderr.count("\n") == 1
    assert lamps.states == []
    assert not (tmp_path / "new.json").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_puts_the_lamp_out_and_keeps_what_was_corrected(tmp_path, number):
    save_rig(make_rig(), tmp_path / "rig.json")
    lamps = Lamps(np.array([1, 0, 2, 3, 4, 5, 6, 7]), watchdog_s=None)
    with lamps.device as device:
        child = subprocess.Popen(
            command(tmp_path, device),
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        child.stdin.write("c 1\n")
        child.stdin.flush()
        until = time.monotonic() + 20
        while lamps.shining != [0] and time.monotonic() < until:
            time.sleep(0.01)
        assert lamps.shining == [0]
        child.send_signal(number)
        assert child.wait(20) == 130
        assert "Traceback" not in child.stderr.read()
        assert device.dark
    assert [a.channel for a in load_rig(tmp_path / "new.json").addresses][:2] == [1, 0]
