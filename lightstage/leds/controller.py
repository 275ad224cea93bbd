"""What a capture asks of an LED controller."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np


@dataclasses.dataclass(frozen=True)
class Hello:
    """Who an LED device says it is.

    Attributes:
        boot_id: changes whenever the device was reset (and went dark).
        light_count: how many lights it drives.
        firmware: its version text.
    """

    boot_id: int
    light_count: int
    firmware: str


class LedController(Protocol):
    """Lights that acknowledge. Every method raises DeviceError when the device does not."""

    @property
    def hello(self) -> Hello:
        """Who is there."""

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Set all lights and wait until they are acknowledged as settled.

        Args:
            levels: (n,) in 0..1, in the rig's order.

        Returns:
            (n,) levels that were really driven (rounded to the device's steps).
        """

    def confirm(self) -> None:
        """Ask what is lit (this also keeps the device awake); DeviceError unless as last set."""

    def dark(self) -> None:
        """All lights off, acknowledged."""

    def close(self) -> None:
        """Give the port back; lights stay as they are."""
