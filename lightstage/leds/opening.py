"""An LED controller by its URL."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

from lightstage.counting import counted
from lightstage.errors import ConfigError, RigError
from lightstage.leds.adalight import AdalightLeds
from lightstage.leds.address import (
    AdalightOptions,
    Address,
    IclOptions,
    SacnOptions,
    SerialOptions,
    parse_url,
)
from lightstage.leds.connection import Line, SocketLine
from lightstage.leds.controller import LedController
from lightstage.leds.sacn import SacnLeds
from lightstage.leds.serial_port import SerialPort
from lightstage.leds.wire_leds import WireLeds
from lightstage.leds.wired import WiredLeds
from lightstage.rig import Rig

MAX_LIGHTS = 65535
BITS_A_BYTE = 10
"""On a serial line, with start and stop bit."""


class OpenLeds(LedController, Protocol):
    """A controller that closes itself at the end of a `with`."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None: ...


def open_rig_leds(url: str | Address, rig: Rig) -> OpenLeds:
    """Open the LED device of a URL for a rig's lights, each at its address.

    Raises:
        ConfigError, DeviceError: as `open_leds`.
        RigError: lights on several controllers, of which one URL opens one.
    """
    device = open_leds(url, channel_count(rig))
    if not rig.addressed:
        return device
    return WiredLeds(device, [address.channel for address in rig.addresses])


def channel_count(rig: Rig) -> int:
    """Channels that a device needs for a rig's lights; RigError where several devices would."""
    names = list(dict.fromkeys(address.controller for address in rig.addresses))
    if len(names) > 1:
        raise RigError(
            "rig",
            field="lights[].address.controller",
            found=f"{len(names)} controllers ({', '.join(names)})",
            expected="one: --leds opens one device",
            hint="Give all lights one controller, and channels that count on over its outputs.",
        )
    return max(address.channel for address in rig.addresses) + 1


def open_leds(url: str | Address, light_count: int) -> OpenLeds:
    """Open the LED device of a URL (docs/led_wire.md); use as a context manager.

    Args:
        url: as `--leds` takes it, or what `parse_url` made of it.
        light_count: channels that the rig's lamps need. A device of our own protocol reports how
            many it has (`hello.light_count`): a capture compares.

    Raises:
        ConfigError: a malformed URL, or a line that cannot carry so many lights.
        DeviceError: nobody there, or in use by another program.
    """
    address = parse_url(url) if isinstance(url, str) else url
    options = address.options
    where = f"LED device at {address}"
    if isinstance(options, IclOptions):
        from lightstage.leds.icl import IclLeds  # takes a while to load; no other device needs it

        return IclLeds(address, light_count)
    if isinstance(options, SacnOptions):
        return SacnLeds(address.place, address.port, light_count, options)
    if light_count > MAX_LIGHTS:
        raise ConfigError(
            "--leds",
            field=address.scheme,
            found=f"{counted(light_count, 'light')} in the rig",
            expected=f"at most {MAX_LIGHTS}: the wire counts them with 16 bits",
        )
    if isinstance(options, AdalightOptions):
        needed_s = _transfer_s(6 + 3 * light_count, options.baud) * options.attempts

        def port() -> SerialPort:
            return SerialPort(address.place, options.baud, options.timeout_s + needed_s)

        return AdalightLeds(where, port, light_count, options)

    def line() -> Line:
        if address.scheme == "socket":
            return SocketLine(address.place, address.port, options.timeout_s)
        if isinstance(options, SerialOptions):
            return SerialPort(address.place, options.baud, options.timeout_s)
        return SerialPort(address.place, timeout_s=options.timeout_s)

    if isinstance(options, SerialOptions):
        needed_s = _transfer_s(12 + 2 * light_count, options.baud)
        if needed_s > options.timeout_s / 2:
            raise ConfigError(
                "--leds",
                field="timeout_s",
                found=f"{options.timeout_s:g} for {counted(light_count, 'light')}, whose levels "
                f"alone take {needed_s:.2g} s at {options.baud} baud",
                expected=f"at least {2 * needed_s:.2g}, or a faster line",
            )
    return WireLeds(where, line, options.timeout_s, options.attempts, options.pulse_hz)


def _transfer_s(size: int, baud: int) -> float:
    return size * BITS_A_BYTE / baud
