"""An LED controller by its URL."""

from __future__ import annotations

from lightstage.leds.serial_controller import SerialLeds, parse_url


def open_leds(url: str, light_count: int) -> SerialLeds:
    """Open the LED device of a URL (docs/led_wire.md); use as a context manager.

    Args:
        url: as `--leds` takes it.
        light_count: lights that the rig has; a device that tells its own is not believed blindly:
            a capture compares.

    Raises:
        ConfigError: a malformed URL.
        DeviceError: nobody there, or in use by another program.
    """
    assert light_count > 0
    return SerialLeds(parse_url(url))
