"""Lights in the rig's order, on a device that counts them by the channels of its line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lightstage.closing import Closing
from lightstage.leds.controller import Hello, LedController
from lightstage.leds.guard import HasLastWill, LastWill


class WiredLeds(Closing):
    """A controller (LedController) whose lamps are where the rig's addresses have them.

    Channels that no light has stay dark.

    Args:
        device: takes levels in the order of its channels.
        channels: of each light of the rig, no channel twice.
    """

    def __init__(self, device: LedController, channels: Sequence[int]) -> None:
        self._device = device
        self._channels = np.array(channels)

    @property
    def hello(self) -> Hello:
        """Who is there; its light count is that of its channels."""
        return self._device.hello

    @property
    def acknowledged(self) -> bool:
        """Whether the device reports what is lit."""
        return self._device.acknowledged

    @property
    def pulse_hz(self) -> float | None:
        """How often a second the lights are switched to dim them."""
        return self._device.pulse_hz

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Set all lights, each on its own channel; (n,) in and out, in the rig's order."""
        # A device of fewer channels refuses the levels; a preflight has reported it before.
        count = max(self._device.hello.light_count, self._channels.max() + 1)
        line = np.zeros(count)
        line[self._channels] = levels
        return np.asarray(self._device.light(line)[self._channels])

    def rewire(self, channels: Sequence[int]) -> None:
        """From the next light on these channels count."""
        self._channels = np.array(channels)

    def confirm(self) -> None:
        """Ask what is lit."""
        self._device.confirm()

    def dark(self) -> None:
        """All channels off."""
        self._device.dark()

    def recover(self) -> Hello:
        """Greet the device again, dark."""
        return self._device.recover()

    def last_will(self) -> LastWill:
        """The device's own: all channels off."""
        assert isinstance(self._device, HasLastWill)
        return self._device.last_will()

    def close(self) -> None:
        """Give the port back."""
        self._device.close()
