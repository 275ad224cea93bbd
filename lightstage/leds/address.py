"""Where an LED device is and how it is spoken to: one URL."""

from __future__ import annotations

from lightstage.leds.serial_controller import SerialAddress as Address
from lightstage.leds.serial_controller import parse_url

__all__ = ["Address", "parse_url"]
