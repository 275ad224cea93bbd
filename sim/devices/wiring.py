"""Which channel of the LED device drives each lamp of a simulated stage."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lightstage.rig import Rig


def wires_of(rig: Rig) -> np.ndarray:
    """(n,) channel of each lamp, where the stage is wired as in its rig."""
    channels = [None if lamp.address is None else lamp.address.channel for lamp in rig.lights]
    return np.array([place if each is None else each for place, each in enumerate(channels)])


def shuffled_wires(rig: Rig, seed: int) -> np.ndarray:
    """(n,) channel of each lamp, where the stage was wired by chance with the rig's channels."""
    return np.random.default_rng(seed).permutation(wires_of(rig))


class Wires:
    """Between a device's channels and the lamps.

    Args:
        channels: (n,) of each lamp.
    """

    def __init__(self, channels: np.ndarray) -> None:
        self._channels = channels
        self.count = int(channels.max()) + 1

    def lamps(self, by_channel: np.ndarray) -> np.ndarray:
        """(n,) what each lamp gets of (m,) values, one a channel."""
        return np.asarray(by_channel)[self._channels]

    def show(self, lamps: Callable[[np.ndarray], None]) -> Callable[[np.ndarray], None]:
        """What a device calls with a level for each channel, for what wants one for each lamp."""
        return lambda by_channel: lamps(self.lamps(by_channel))

    def channels(self, by_lamp: list[str]) -> list[str]:
        """A text of each channel, from one of each lamp; empty where a channel has none."""
        line = [""] * self.count
        for channel, text in zip(self._channels, by_lamp, strict=True):
            line[channel] = text
        return line
