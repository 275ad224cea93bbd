"""LED devices at the far end of a line, each in a thread of its own (docs/led_wire.md)."""

from __future__ import annotations

import abc
import dataclasses
import os
import select
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, Self

import numpy as np

from sim.devices.faults import FaultLog, Story
from sim.devices.led_ends import End, PtyEnd, TcpEnd
from sim.devices.led_faults import FaultyLeds, Step, Wait
from sim.devices.led_protocol import FULL_COUNT

SETTLE_TIMEOUT_S = 110.0
"""Lamps of the simulator settle when all cameras' pictures are rendered; the driver waits that
long."""
WATCHDOG_S = 2.0
"""Time without a packet after which a stage's device goes dark, as firmware must."""


@dataclasses.dataclass(frozen=True)
class LitState:
    """What was lit from `at_s` on.

    Attributes:
        at_s: monotonic clock, when the lamps had settled and before it was acknowledged.
        counts: (n,) uint16 level of each light, as it really shone.
    """

    at_s: float
    counts: np.ndarray


class EndDevice(abc.ABC):
    """A device at one end of a line. Use as a context manager; a new device is dark.

    What `show` raises is kept in `failure`, and the device falls silent: a lamp that did not settle
    is not acknowledged.

    Args:
        light_count: lights that it drives.
        end: of the line.
        show: called with (n,) levels in 0..1 whenever what shines changes.
        log: where it is noted what goes wrong.

    Attributes:
        path: the line, as it is in a URL.
        states: what was lit, in order, the dark start included.
        log: what went wrong.
        failure: what `show` raised.
        connected: set while a host has the line open, as far as the device has seen.
        heard_s: monotonic clock, when it last heard something that keeps its lights on.
        silences: how often it went dark by itself, because nobody spoke for too long.
    """

    def __init__(
        self,
        light_count: int,
        end: End,
        show: Callable[[np.ndarray], None],
        log: FaultLog | None,
    ) -> None:
        self._end = end
        self._show = show
        self.log = FaultLog() if log is None else log
        self.states = [LitState(time.monotonic(), np.zeros(light_count, "<u2"))]
        self.failure: BaseException | None = None
        self.connected = threading.Event()
        self.heard_s = time.monotonic()
        self.silences = 0
        self.path = end.place
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="led-device", daemon=True)

    @property
    def dark(self) -> bool:
        """Whether no light shines."""
        return not self.states[-1].counts.any()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._stop_write, b"x")
        self._thread.join()
        self._end.close()
        for handle in (self._stop_read, self._stop_write):
            os.close(handle)

    @abc.abstractmethod
    def _opened(self) -> Iterable[Step]:
        """A host has opened the line."""

    @abc.abstractmethod
    def _feed(self, data: bytes) -> Iterable[Step]:
        """Bytes have come."""

    @abc.abstractmethod
    def _deadline_s(self) -> float | None:
        """When the device does something by itself (monotonic)."""

    @abc.abstractmethod
    def _expire(self) -> None:
        """Do it."""

    def _settle(self, levels: np.ndarray) -> None:
        self._show(levels)
        counts = np.round(levels * FULL_COUNT).astype("<u2")
        self.states.append(LitState(time.monotonic(), counts))

    def _serve(self) -> None:
        try:
            while True:
                due_s = self._deadline_s()
                event = self._end.wait(
                    self._stop_read, None if due_s is None else due_s - time.monotonic()
                )
                if event == "stop":
                    return
                if event == "data":
                    self._take(self._feed(self._end.read()))
                elif event == "closed":
                    self.connected.clear()
                elif event == "opened":
                    self.connected.set()
                    self._take(self._opened())
                if due_s is not None and time.monotonic() >= due_s:
                    self._expire()
        except BaseException as failure:  # whatever it is, the owner must learn of it
            self.failure = failure

    def _take(self, steps: Iterable[Step]) -> None:
        for step in steps:
            if isinstance(step, Wait):
                if self._stopped(step.seconds):
                    return
                if step.deaf:
                    self._forget()
            else:
                self._end.send(step)

    def _stopped(self, seconds: float) -> bool:
        """Wait, unless the device is taken down."""
        return bool(select.select([self._stop_read], [], [], seconds)[0])

    def _forget(self) -> None:
        while self._end.wait(self._stop_read, 0.0) == "data":
            self._end.read()


class LedDevice(EndDevice):
    """A device of our own protocol on a pseudo-terminal or a TCP port.

    Args:
        light_count: lights that it drives.
        show: called with (n,) levels in 0..1 whenever what shines changes.
        boot_id: changes with each reset.
        story: what goes wrong; nothing by default.
        log: where that is noted.
        banks: polarisation bank of each light, for a story that swaps them.
        watchdog_s: dark after so long without a packet; None: the state stays, for tests that ask.
        over: what the line is.
    """

    def __init__(
        self,
        light_count: int,
        show: Callable[[np.ndarray], None],
        boot_id: int = 1,
        story: Story | None = None,
        log: FaultLog | None = None,
        banks: Sequence[str] = (),
        watchdog_s: float | None = None,
        over: Literal["pty", "socket"] = "pty",
    ) -> None:
        super().__init__(light_count, PtyEnd() if over == "pty" else TcpEnd(), show, log)
        self._scheme = over
        self._leds = FaultyLeds(
            light_count, boot_id, self._settle, story or Story(), self.log, banks, watchdog_s
        )
        self._watchdog_s = watchdog_s

    @property
    def commanded(self) -> np.ndarray:
        """(n,) uint16 that the host asked for last, whatever shines."""
        return self._leds.protocol.counts

    def url(self, timeout_s: float, attempts: int = 1) -> str:
        """The device's address for `lightstage capture --leds`."""
        return f"{self._scheme}://{self.path}?timeout_s={timeout_s:g}&attempts={attempts}"

    def _opened(self) -> Iterable[Step]:
        return self._leds.opened()

    def _feed(self, data: bytes) -> Iterable[Step]:
        before = self._leds.protocol.heard
        yield from self._leds.feed(data)
        if self._leds.protocol.heard != before:
            self.heard_s = time.monotonic()

    def _deadline_s(self) -> float | None:
        if self._watchdog_s is None or self._leds.dead or not self._leds.protocol.counts.any():
            return None
        return self.heard_s + self._watchdog_s

    def _expire(self) -> None:
        due_s = self._deadline_s()
        if due_s is not None and time.monotonic() >= due_s:
            self.silences += 1
            self._leds.protocol.put_out()
