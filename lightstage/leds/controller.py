"""What a capture asks of an LED controller."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from lightstage.errors import DeviceError


class LightLostError(DeviceError):
    """What is lit is not what was set, or is not known: after `recover` take the shot again."""


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
    """Lights. Every method raises DeviceError when the device fails. Several threads may call.

    A controller that does not acknowledge says so: what it lights is then what was sent, and every
    photograph taken under it is recorded as unacknowledged.
    """

    @property
    def hello(self) -> Hello:
        """Who is there; without acknowledgement, what is known from its address."""

    @property
    def acknowledged(self) -> bool:
        """Whether the device tells what is lit."""

    @property
    def pulse_hz(self) -> float | None:
        """How often a second the lights are switched to dim them; None where it is not known."""

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

    def recover(self) -> Hello:
        """After LightLostError: open what was closed, greet the device again, all lights off.

        What was lit is not lit again: the shot is, by whoever takes it again. DeviceError when
        nobody answers, or somebody else does.
        """

    def close(self) -> None:
        """Give the port back; lights stay as they are."""
