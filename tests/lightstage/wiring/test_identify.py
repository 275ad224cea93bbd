"""`lightstage lights identify`: one lamp at a time, addresses corrected by what is seen."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import DeviceError
from lightstage.operator.keys import key_by_key
from lightstage.rig import LightAddress, load_rig, save_rig
from lightstage.safety import SafetyConfig
from lightstage.wiring.command import Keys
from lightstage.wiring.identify import identify
from lightstage.wiring.walk import Walk, corrections, place_in_words
from sim.devices.faults import Fault, Story
from sim.devices.led_device import LedDevice
from sim.devices.wiring import Wires, shuffled_wires
from tests.lightstage.conftest import make_rig
from tests.waiting import until

pytestmark = pytest.mark.usefixtures("forked")

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


def test_an_operator_who_answers_what_shines_finds_every_address():
    rig = make_rig()
    wires = shuffled_wires(rig, 3)
    lamps = Lamps(wires)
    right: set[int] = set()
    lines: list[str] = []

    def ask(_: str) -> str:
        meant = int(re.findall(r"^Lamp (\d+)", lines[-1])[0])
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
        "Lamp 0 (corner0), 1 of 8: 135 degrees to the left (behind the person), 35 degrees down; "
        "channel 0 of main"
    )


def told_lights(told):
    """Keeps the lines that name a lamp."""
    return lambda line: told.append(line) if re.match(r"Lamp \d+ \(\w+\), ", line) else None


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
    # Lamp 2's wire was free: its channel of before lights nothing.
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
    walk = Walk(rig, {"main": 10})
    for line in lines:
        walk.hear(line)
        channels = [address.channel for address in walk.rig.addresses]
        assert len(set(channels)) == 8
        assert max(channels) < 10
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
def test_a_place_is_reported_as_the_frontal_camera_sees_it(place, words):
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
        "lamp 0 (corner0): channel 0 -> 1",
        "lamp 1 (corner1): channel 1 -> 0",
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
        until(lambda: lamps.shining == [0])
        child.send_signal(number)
        assert child.wait(20) == 130
        assert "Traceback" not in child.stderr.read()
        assert device.dark
    assert [a.channel for a in load_rig(tmp_path / "new.json").addresses][:2] == [1, 0]


def test_on_two_controllers_a_light_gets_the_wire_that_lights_it():
    addresses = [LightAddress(i // 2, ("left", "right")[i % 2]) for i in range(8)]
    rig = make_rig().readdressed(addresses)
    wires = [addresses[i] for i in (1, 0, 2, 3, 4, 5, 7, 6)]  # two pairs are swapped
    lit: dict[str, list[int]] = {"left": [], "right": []}

    def see(name):
        def seen(levels):
            lit[name][:] = [int(i) for i in np.flatnonzero(levels)]

        return seen

    def shining() -> int:
        ((name, channel),) = [(name, each) for name, found in lit.items() for each in found]
        return wires.index(LightAddress(channel, name))

    lines: list[str] = []
    right: set[int] = set()

    def ask(_: str) -> str:
        meant = int(re.findall(r"^Lamp (\d+)", lines[-1])[0])
        if shining() != meant:
            return f"s {shining()}"
        right.add(meant)
        return "q" if len(right) == 8 else "n"

    with LedDevice(4, see("left")) as left, LedDevice(4, see("right")) as other:
        urls = f"left={left.url(20.0)},right={other.url(20.0)}"
        found = identify(rig, urls, ask, told_lights(lines), lambda _: None, QUICK, 0.5)
        assert left.dark
        assert other.dark
    assert list(found.addresses) == wires
    assert corrections(rig, found)[0] == ("lamp 0 (corner0): channel 0 of left -> 0 of right")


@pytest.mark.parametrize(
    ("pieces", "line"),
    [
        (["n"], "n"), (["b"], "b"), (["d"], "d"), (["q"], "q"), (["\r"], ""), (["\n"], ""),
        ([" "], ""), (["N"], "n"),
        (["1", "7", "\n"], "17"), (["c", "4", "0", "\n"], "c40"), (["s23\n"], "s23"),
        (["1", "8", "\x7f", "7", "\r"], "17"), (["1", "\x1b", "n"], "n"), (["\x1b[A", "b"], "b"),
        (["x", "?", "é", "n"], "n"), (["nnnn"], "n"), (["c", "n", "4", "\n"], "c4"),
    ],
)  # fmt: skip
def test_one_key_is_one_step_and_only_a_number_ends_with_enter(pieces, line):
    master, terminal = os.openpty()
    try:
        with key_by_key(terminal):
            waiting = iter(pieces)

            def feed():
                for piece in waiting:
                    os.write(master, piece.encode())
                    time.sleep(0.02)

            thread = threading.Thread(target=feed)
            thread.start()
            assert Keys(terminal).ask("") == line
            thread.join()
            assert Walk(make_rig(), {"main": 100}).hear(line) is not None
    finally:
        os.close(master)
        os.close(terminal)


def test_the_command_lights_the_next_lamp_on_one_key_without_enter(tmp_path):
    save_rig(make_rig(), tmp_path / "rig.json")
    lamps = Lamps(np.arange(8))
    master, terminal = os.openpty()
    with lamps.device as device:
        child = subprocess.Popen(
            command(tmp_path, device), stdin=terminal, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        os.close(terminal)
        for key, lit in (("", [0]), ("n", [1]), ("n", [2]), ("b", [1]), ("d", []), ("q", [])):
            os.write(master, key.encode())
            until(lambda lit=lit: lamps.shining == lit, 60)
        assert child.wait(30) == 0, child.stderr.read()
        assert device.dark
    os.close(master)
    assert not (tmp_path / "new.json").exists()
