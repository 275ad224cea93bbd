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
    """An LED device's identity.

    Attributes:
        boot_id: changes whenever the device was reset (and went dark); 0 where it is not known.
        light_count: how many lights it drives.
        firmware: its version text.
        watchdog_s: after so long without a packet it goes dark by itself; None where it is not
            known to do so.
        pulse_hz: how often a second it switches its lamps to dim them; None where not known.
        keep_alive_s: how often its protocol repeats a state that does not change; None where it
            is not known.
    """

    boot_id: int
    light_count: int
    firmware: str
    watchdog_s: float | None = None
    pulse_hz: float | None = None
    keep_alive_s: float | None = None


class LedController(Protocol):
    """Lights. Every method raises DeviceError when the device fails. Several threads may call.

    A controller that does not acknowledge states it: what it lights is then what was sent, and
    every photograph taken under it is recorded as unacknowledged.
    """

    @property
    def hello(self) -> Hello:
        """Who is there; without acknowledgement, what is known from its address."""

    @property
    def acknowledged(self) -> bool:
        """Whether the device reports what is lit."""

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
        """Ask what is lit (this also keeps the device awake); DeviceError unless as last set.

        Without acknowledgement the state is sent again; DeviceError where that fails.
        """

    def dark(self) -> None:
        """All lights off, acknowledged. Does not wait for another thread's request to fail."""

    def recover(self) -> Hello:
        """After LightLostError: open what was closed, greet the device again, all lights off.

        The previous light is not restored; the caller retakes the shot. DeviceError when nobody
        answers, or another device does.
        """

    def close(self) -> None:
        """Give the port back; lights stay as they are."""


def require_levels(levels: np.ndarray) -> np.ndarray:
    """Levels as (n,) float64, refused where one is no level.

    Args:
        levels: (n,) in 0..1.

    Raises:
        DeviceError: another shape, NaN or out of range; a level is refused, never clipped.
    """
    values = np.asarray(levels, float)
    if values.ndim != 1 or not ((values >= 0) & (values <= 1)).all():
        raise DeviceError(
            "levels", found=f"shape {values.shape}, not all in 0..1", expected="(n,) in 0..1"
        )
    return values


def level_steps(levels: np.ndarray, full: int) -> np.ndarray:
    """Levels in a device's whole steps.

    Args:
        levels: (n,) in 0..1.
        full: step of level 1.

    Returns:
        (n,) int64 in 0..full, rounded to the nearest.

    Raises:
        DeviceError: as `require_levels`.
    """
    return np.round(require_levels(levels) * full).astype(np.int64)
