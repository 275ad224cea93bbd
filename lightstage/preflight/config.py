"""Limits of the checks before a capture, and what the capture is about to take."""

from __future__ import annotations

import dataclasses
from typing import Literal

from lightstage.errors import ConfigError

Series = Literal["either", "marked", "true"]


@dataclasses.dataclass(frozen=True)
class PreflightConfig:
    """Limits.

    Attributes:
        min_battery_percent: of each camera.
        max_clock_offset_s: between a camera's clock and this computer's.
        space_margin: share that disk and cards must hold beyond the plan.
        max_pulse_error: share by which pulsed lights may be brighter or darker in one photograph
            than in another.
        shutter_series: what a marked shutter time lasts: as marked, the true time of its place in
            the series of powers of 2, or either (then both must do).
        first_year: the computer's clock shows no earlier one.
        max_trigger_skew_s: between the first and the last camera of one shot; more is reported.
        believe_camera_clocks: whether a photograph whose time in its file is not that of its shot,
            by its camera's clock, is refused as an old picture. Without it, and where
            a camera or a file has no time, old pictures are known by their bytes alone, and by
            the card's files at the beginning.
        clear: whether owner, artist, copyright and place are cleared on the cameras; otherwise
            cameras that have them are refused.
        ignore_clock: a journal beside the session whose last line is later than this computer's
            clock is a warning alone; otherwise it is refused.
    """

    min_battery_percent: float = 20.0
    max_clock_offset_s: float = 60.0
    space_margin: float = 0.1
    max_pulse_error: float = 0.002
    shutter_series: Series = "either"
    first_year: int = 2025
    max_trigger_skew_s: float = 0.1
    believe_camera_clocks: bool = True
    clear: bool = False
    ignore_clock: bool = False

    def __post_init__(self) -> None:
        """ConfigError on a limit that is no limit."""
        for name in LIMITS:
            value = getattr(self, name)
            if not 0 <= value < float("inf"):
                raise ConfigError(
                    "preflight", field=name, found=repr(value), expected="0 or more, and finite"
                )


LIMITS = (
    "min_battery_percent",
    "max_clock_offset_s",
    "space_margin",
    "max_pulse_error",
    "first_year",
    "max_trigger_skew_s",
)


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a capture is about to take.

    Attributes:
        photographs_per_camera: still to be taken, with a few to take again.
        bytes_per_photograph: of the largest so far; guessed from the rig's pixels where None.
        patterns: names, for the lengths of paths.
        lowest_level: smallest level above 0 that a light is dimmed to; 1 where lights are only
            on or off.
    """

    photographs_per_camera: int
    bytes_per_photograph: int | None = None
    patterns: tuple[str, ...] = ()
    lowest_level: float = 1 / 65535
