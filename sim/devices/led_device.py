"""The far end of the LED wire: a device behind a pseudo-terminal (docs/led_wire.md)."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType

import numpy as np

from sim.devices.faults import FaultLog, Story
from sim.devices.led_faults import FaultyLeds, Step, Wait
from sim.devices.led_protocol import FULL_COUNT

OPEN_POLL_MS = 5
"""While nobody has the port open, the kernel tells of an opening only to those who ask."""
READ_BYTES = 65536


@dataclasses.dataclass(frozen=True)
class LitState:
    """What was lit from `at_s` on.

    Attributes:
        at_s: monotonic clock, when the lamps had settled and before it was acknowledged.
        counts: (n,) uint16 level of each light, as it really shone.
    """

    at_s: float
    counts: np.ndarray


class LedDevice:
    """An LED device at the master end of a pseudo-terminal, in a thread of its own.

    Use as a context manager. A new device is dark. What `show` raises is kept in `failure`, and
    the device falls silent: a lamp that did not settle is not acknowledged.

    Args:
        light_count: lights that it drives.
        show: called with (n,) levels in 0..1 whenever what shines changes.
        boot_id: changes with each reset.
        story: what goes wrong; nothing by default.
        log: where that is noted.
        banks: polarisation bank of each light, for a story that swaps them.

    Attributes:
        path: of the end that the host opens.
        states: what was lit, in order, the dark start included.
        log: what went wrong.
        failure: what `show` raised.
        connected: set while a host has the port open, as far as the device has seen.
    """

    def __init__(
        self,
        light_count: int,
        show: Callable[[np.ndarray], None],
        boot_id: int = 1,
        story: Story | None = None,
        log: FaultLog | None = None,
        banks: Sequence[str] = (),
    ) -> None:
        self._show = show
        self.log = FaultLog() if log is None else log
        self._leds = FaultyLeds(
            light_count, boot_id, self._settle, story or Story(), self.log, banks
        )
        self.states = [LitState(time.monotonic(), self._leds.protocol.counts)]
        self.failure: BaseException | None = None
        self.connected = threading.Event()
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        # Not kept open here: only so does the master learn when a host opens it.
        os.close(slave)
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="led-device", daemon=True)

    def url(self, timeout_s: float, attempts: int = 1) -> str:
        """The device's address for `lightstage capture --leds`."""
        return f"pty://{self.path}?timeout_s={timeout_s:g}&attempts={attempts}"

    @property
    def dark(self) -> bool:
        """Whether no light shines."""
        return not self.states[-1].counts.any()

    def __enter__(self) -> LedDevice:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.write(self._stop_write, b"x")
        self._thread.join()
        for handle in (self._master, self._stop_read, self._stop_write):
            os.close(handle)

    def _settle(self, levels: np.ndarray) -> None:
        self._show(levels)
        counts = np.round(levels * FULL_COUNT).astype("<u2")
        self.states.append(LitState(time.monotonic(), counts))

    def _serve(self) -> None:
        try:
            while (ready := self._poll()) is not None:
                if ready & select.POLLIN and self.connected.is_set():
                    self._take(self._leds.feed(os.read(self._master, READ_BYTES)))
                elif ready & select.POLLHUP and not ready & select.POLLIN:
                    self.connected.clear()
                    if self._stopped(OPEN_POLL_MS / 1e3):
                        return
                elif not self.connected.is_set():
                    self.connected.set()
                    self._take(self._leds.opened())
        except BaseException as failure:  # whatever it is, the owner must learn of it
            self.failure = failure

    def _poll(self) -> int | None:
        """Events of the master: POLLHUP while nobody has the port open; None at the end."""
        poll = select.poll()
        poll.register(self._stop_read, select.POLLIN)
        poll.register(self._master, select.POLLIN)
        # Unconnected, that the port is open shows only as the absence of POLLHUP.
        found = dict(poll.poll(None if self.connected.is_set() else 0))
        return None if self._stop_read in found else found.get(self._master, 0)

    def _take(self, steps: Iterable[Step]) -> None:
        for step in steps:
            if isinstance(step, Wait):
                if self._stopped(step.seconds):
                    return
                if step.deaf:
                    self._forget()
            else:
                self._send(step)

    def _stopped(self, seconds: float) -> bool:
        """Wait, unless the device is taken down."""
        return bool(select.select([self._stop_read], [], [], seconds)[0])

    def _send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):  # nobody has the port open: said into the void
            while data:
                data = data[os.write(self._master, data) :]

    def _forget(self) -> None:
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        while any(event & select.POLLIN for _, event in poll.poll(0)):
            os.read(self._master, READ_BYTES)
