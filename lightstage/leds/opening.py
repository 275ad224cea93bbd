"""An LED controller by its URL."""

from __future__ import annotations

import contextlib
from types import TracebackType
from typing import Protocol, Self

from lightstage.counting import counted
from lightstage.errors import ConfigError, DeviceError, RigError
from lightstage.leds.adalight import AdalightLeds
from lightstage.leds.address import (
    AdalightOptions,
    Address,
    IclOptions,
    SacnOptions,
    SerialOptions,
    parse_leds,
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


def open_rig_leds(leds: str, rig: Rig) -> OpenLeds:
    """Open the LED devices of a rig's lights, each light at its address.

    Args:
        leds: as `--leds` takes it: a URL, or one of each controller (`parse_leds`).
        rig: whose addresses name the controllers.

    Raises:
        ConfigError, DeviceError: as `open_wired_leds`.
        RigError: other controllers than `leds` names.
    """
    if rig.addressed:
        return open_wired_leds(leds, rig)
    (address,) = _addresses(leds, rig).values()
    return open_leds(address, len(rig.lights))


def open_wired_leds(leds: str, rig: Rig, channels: int = 0) -> WiredLeds:
    """The same, also where the rig gives no address; they can be wired anew.

    Args:
        leds: as of `open_rig_leds`.
        rig: the same.
        channels: at least so many of a device that does not report how many it has.

    Raises:
        ConfigError: a malformed URL, or a line that cannot carry so many lights.
        DeviceError: nobody there, or in use by another program; of several devices one that has
            fewer channels than the rig needs.
        RigError: other controllers than `leds` names.
    """
    addresses, needed = _addresses(leds, rig), channels_needed(rig)
    with contextlib.ExitStack() as opened:
        devices = {
            name: opened.enter_context(open_leds(address, max(needed[name], channels)))
            for name, address in addresses.items()
        }
        wired = WiredLeds(devices, rig.addresses)
        # Of one device the preflight reports it, beside all else that is wrong.
        if len(devices) > 1:
            require_channels(wired, rig, leds)
        opened.pop_all()
    return wired


def require_channels(wired: WiredLeds, rig: Rig, leds: str) -> None:
    """DeviceError where a device, opened at `leds`, has fewer channels than the rig needs."""
    addresses, needed = _addresses(leds, rig), channels_needed(rig)
    for name, count in wired.counts.items():
        if count < needed[name]:
            several = len(wired.counts) > 1
            named = f" {name}" if several else ""
            raise DeviceError(
                f"LED device{named} at {addresses[name]}",
                field="lamp count",
                found=str(count),
                expected=f"at least {needed[name]} (addresses in rig.json)",
                hint="Is this the rig file of this stage"
                + (", and each controller at its own URL?" if several else "?"),
            )


def channels_needed(rig: Rig) -> dict[str, int]:
    """How many channels each controller needs for a rig's lights, by its name."""
    needed: dict[str, int] = {}
    for each in rig.addresses:
        needed[each.controller] = max(needed.get(each.controller, 0), each.channel + 1)
    return needed


def require_controllers(leds: str, rig: Rig) -> None:
    """ConfigError or RigError where `leds` does not name a rig's controllers; nothing is opened."""
    _addresses(leds, rig)


def _addresses(leds: str, rig: Rig) -> dict[str, Address]:
    """The address of each controller of a rig; RigError where `leds` names others."""
    given, needed = parse_leds(leds), channels_needed(rig)
    if set(given) == {""} and len(needed) == 1:
        return {next(iter(needed)): given[""]}
    if set(given) != set(needed):
        named = f"URLs of {', '.join(given)}" if "" not in given else "one URL"
        raise RigError(
            "rig",
            field="lights[].address.controller",
            found=f"{counted(len(needed), 'controller')} ({', '.join(needed)}), and {named} "
            "in --leds",
            expected="a URL of each controller",
            hint=f"Give --leds '{','.join(f'{name}=URL' for name in needed)}'.",
        )
    return {name: given[name] for name in needed}


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
            found=f"{counted(light_count, 'lamp')} in the rig",
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
                found=f"{options.timeout_s:g} for {counted(light_count, 'lamp')}, whose levels "
                f"alone take {needed_s:.2g} s at {options.baud} baud",
                expected=f"at least {2 * needed_s:.2g}, or a faster line",
            )
    return WireLeds(where, line, options.timeout_s, options.attempts, options.pulse_hz)


def _transfer_s(size: int, baud: int) -> float:
    return size * BITS_A_BYTE / baud
