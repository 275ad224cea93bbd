"""Lights that only listen: what is lit is what was sent, and nobody confirms it."""

from __future__ import annotations

import abc
import threading
import time

import numpy as np

from lightstage.closing import Closing
from lightstage.errors import DeviceError
from lightstage.leds.address import UnansweredOptions
from lightstage.leds.controller import Hello


class UnansweredLeds(Closing):
    """What controllers without acknowledgement share (LedController).

    Args:
        where: its name in messages.
        light_count: lights of the rig.
        firmware: what is recorded of the device.
        options: of its address.
        keep_alive_s: how often the protocol repeats a state; None where it is not known.
    """

    acknowledged = False

    def __init__(
        self,
        where: str,
        light_count: int,
        firmware: str,
        options: UnansweredOptions,
        keep_alive_s: float | None = None,
    ) -> None:
        self._where = where
        self._repeats, self._settle_s = options.attempts, options.settle_s
        self._pulse_hz = options.pulse_hz
        self._turn = threading.RLock()
        self._steps = np.zeros(light_count, np.int64)
        self._hello = Hello(0, light_count, firmware, keep_alive_s=keep_alive_s)

    @property
    def hello(self) -> Hello:
        """From the address."""
        return self._hello

    @property
    def pulse_hz(self) -> float | None:
        """From the address."""
        return self._pulse_hz

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Send all (n,) levels; returns when they are out and had time to settle."""
        steps = self._to_steps(levels)
        if len(steps) != self._hello.light_count:
            raise DeviceError(
                self._where,
                field="levels",
                found=str(len(steps)),
                expected=str(self._hello.light_count),
            )
        with self._turn:
            self._steps = steps
            self._send(self._repeats)
        # Others may send to the device meanwhile: to keep it awake, or to make it dark at once.
        time.sleep(self._settle_s)
        return self._to_levels(steps)

    def confirm(self) -> None:
        """Send the state once more; LightLostError when nothing takes it."""
        with self._turn:
            self._send(1)

    def dark(self) -> None:
        """Send zeros."""
        with self._turn:
            self._steps = np.zeros_like(self._steps)
            self._send(self._repeats)

    @abc.abstractmethod
    def _to_steps(self, levels: np.ndarray) -> np.ndarray:
        """(n,) whole steps of the device for (n,) levels; DeviceError where one is out of range."""

    @abc.abstractmethod
    def _to_levels(self, steps: np.ndarray) -> np.ndarray:
        """(n,) levels that steps are."""

    @abc.abstractmethod
    def _send(self, times: int) -> None:
        """Send the state so often; LightLostError when nothing takes it."""
