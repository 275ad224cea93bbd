"""The firmware by itself behind a pseudo-terminal, with this computer's clock, and our driver."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lightstage.leds import wire
from lightstage.leds.controller import LightLostError
from lightstage.leds.guard import Guardian
from lightstage.leds.opening import OpenLeds, open_leds
from lightstage.leds.wire import Kind, Packet

LIGHTS = 8
WATCHDOG_S = 0.9
LONG_S = 30.0
FULL, DARK = np.full(LIGHTS, wire.FULL), np.zeros(LIGHTS, int)


class Served:
    """A running firmware/host/serve.

    Attributes:
        path: of its terminal.
        states: its clock in seconds, and (n,) u16 levels, for each time that it wrote the lamps.
    """

    def __init__(self, program: Path) -> None:
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self.path = self._process.stdout.readline().strip()
        self.states: list[tuple[float, np.ndarray]] = []
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            ms, digits = line.split()
            levels = np.frombuffer(bytes.fromhex(digits), ">u2").astype(int)
            self.states.append((int(ms) / 1e3, levels))

    def open(self) -> OpenLeds:
        """Our driver, as a capture opens it."""
        return open_leds(f"pty://{self.path}?timeout_s=5", LIGHTS)

    def since(self, counts: np.ndarray) -> float:
        """Wait until the lamps have these levels; its clock when they were written."""
        until = time.monotonic() + LONG_S
        while time.monotonic() < until:
            if self.states and np.array_equal(self.states[-1][1], counts):
                return self.states[-1][0]
            time.sleep(0.002)
        raise AssertionError(f"the lamps stay at {self.states[-1:]}")

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        assert self._process.wait(LONG_S) == 0
        self._thread.join()
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture
def served(compiled) -> Iterator[Served]:
    served = Served(compiled("serve", LIGHTS))
    yield served
    served.close()


def test_our_driver_lights_it_and_a_second_host_finds_it_dark(served) -> None:
    levels = np.linspace(0, 1, LIGHTS)
    for _ in range(2):
        with served.open() as leds:
            assert leds.hello.light_count == LIGHTS
            assert leds.hello.watchdog_s == WATCHDOG_S
            assert leds.hello.firmware.startswith("lightstage-firmware")
            driven = leds.light(levels)
            served.since(np.round(driven * wire.FULL))
            leds.confirm()
            leds.dark()
            served.since(DARK)


def test_a_host_that_falls_silent_loses_its_light_and_gets_that_answer(served) -> None:
    with served.open() as leds:
        leds.light(np.ones(LIGHTS))
        lit_s = served.since(FULL)
        # Its own clock, in milliseconds: not before its time.
        assert served.since(DARK) - lit_s > WATCHDOG_S - 0.002
        with pytest.raises(LightLostError, match="not as they were set"):
            leds.confirm()
        leds.recover()
        leds.light(np.ones(LIGHTS))
        leds.dark()


def test_the_guardian_of_a_killed_capture_is_answered_that_it_is_dark(served) -> None:
    with served.open() as leds:
        guardian = Guardian(leds.last_will(), LONG_S)
        leds.light(np.ones(LIGHTS))
        guardian.leave()
        assert guardian._child.returncode == 0  # 1 where no answer came in its ten seconds
        served.since(DARK)


def test_a_host_that_reads_no_answer_and_sends_for_ever_does_not_stop_its_clock(served) -> None:
    handle = os.open(served.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        ask = b"".join(wire.encode(Packet(Kind.ASK_STATE, n)) for n in range(2, 2000))
        os.write(handle, wire.encode(Packet(Kind.SET, 1, wire.set_payload(FULL))))
        served.since(FULL)
        # Many more answers than a terminal holds.
        for _ in range(4):
            with contextlib.suppress(BlockingIOError):
                os.write(handle, ask)
            time.sleep(0.01)
        served.since(DARK)
    finally:
        os.close(handle)
