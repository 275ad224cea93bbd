"""Where an LED device is and how it is spoken to: one URL, read and checked."""

from __future__ import annotations

import dataclasses
import re
import typing
import urllib.parse

from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.config import make_config

SACN_PORT = 5568
MULTICAST = "multicast"
"""In place of a host: each universe to its own group."""


@dataclasses.dataclass(frozen=True)
class Options:
    """What every URL may have.

    Attributes:
        timeout_s: how long one attempt waits for its answer, or for the port to take the bytes.
        attempts: how often a request is sent before the device counts as silent; without
            acknowledgement, how often each state is sent.
        pulse_hz: how often a second the lights are switched to dim them, where it is known: an
            exposure should last whole pulses.
    """

    timeout_s: float = 2.0
    attempts: int = 3
    pulse_hz: float | None = None

    @property
    def worst_s(self) -> float:
        """After so long a request has failed, or its light has settled."""
        return self.timeout_s * self.attempts


@dataclasses.dataclass(frozen=True)
class UnansweredOptions(Options):
    """What the URL of every device may have that does not acknowledge its light.

    Attributes:
        settle_s: after the last byte is out until the light counts as settled.
    """

    attempts: int = 2
    settle_s: float = 0.05

    @property
    def worst_s(self) -> float:
        """After so long a request has failed, or its light has settled."""
        return super().worst_s + self.settle_s


@dataclasses.dataclass(frozen=True)
class SerialOptions(Options):
    """Our own protocol on a serial port.

    Attributes:
        baud: line speed.
    """

    baud: int = 921600


@dataclasses.dataclass(frozen=True)
class AdalightOptions(UnansweredOptions):
    """Adalight on a serial port.

    Attributes:
        baud: line speed.
        colour: RRGGBB that full level shall have; a white mixed of unequal primaries.
        order: in which the LEDs take their three bytes.
        gamma: of the device: its light goes with (value / 255) ** gamma.
    """

    baud: int = 115200
    colour: str = "ffffff"
    order: str = "rgb"
    gamma: float = 1.0


@dataclasses.dataclass(frozen=True)
class SacnOptions(UnansweredOptions):
    """E1.31 (sACN) over UDP.

    Attributes:
        universe: of the first light; the following lights fill those after it.
        priority: 0 to 200 [ANSI-E131-2018].
        channels: slots of a light, all driven alike (or pairs of slots, with 16 bits).
        bits: 8, or 16 as a coarse and a fine slot.
        gamma: of the device: its light goes with (value / full) ** gamma.
        interface: address of the network card by which multicast leaves; the system's choice.
    """

    attempts: int = 3
    universe: int = 1
    priority: int = 100
    channels: int = 1
    bits: int = 8
    gamma: float = 1.0
    interface: str = ""


@dataclasses.dataclass(frozen=True)
class IclOptions(UnansweredOptions):
    """lsserver of ICL's stage, over a WebSocket (docs/icl.md).

    Attributes:
        lights: which emitters a channel is: `white`, `rgb`, `both`, `polarised`, `emitters`.
        rgb: RRGGBB of a fixture's red, green and blue emitter at full level.
        white: the same of its warm, neutral and cool emitter.
        settle_s: longer, as the server sends a state that it took every 33 ms.
    """

    timeout_s: float = 5.0
    lights: str = "white"
    rgb: str = "ffffff"
    white: str = "ffffff"
    settle_s: float = 0.1


ICL_LIGHTS = ("white", "rgb", "both", "polarised", "emitters")
OPTIONS: dict[str, type[Options]] = {
    "serial": SerialOptions,
    "pty": Options,
    "socket": Options,
    "adalight": AdalightOptions,
    "sacn": SacnOptions,
    "ws": IclOptions,
}
WRITTEN = {
    "serial": "serial:///dev/ttyX?baud=..",
    "pty": "pty:///dev/pts/N",
    "socket": "socket://HOST:PORT",
    "adalight": "adalight:///dev/ttyX?baud=..",
    "sacn": "sacn://HOST or sacn://multicast?universe=..",
    "ws": "ws://HOST:8080/ws of ICL's stage",
}
"""Scheme to how its URLs are written: in help and in messages."""
EXPECTED = ", ".join(WRITTEN[scheme] for scheme in OPTIONS)
LEDS_HELP = f"The LED device: {EXPECTED}; several as NAME=URL,NAME=URL."
_NAMED = r"[^=,:/?&]+=[a-z0-9]+://"
"""How an entry begins that names its controller."""
RANGES: dict[str, tuple[float, float]] = {
    "timeout_s": (1e-3, 3600),
    "attempts": (1, 100),
    "pulse_hz": (1, 1e7),
    "baud": (300, 1e8),
    "gamma": (0.1, 10),
    "settle_s": (0, 60),
    "universe": (1, 63999),
    "priority": (0, 200),
    "channels": (1, 16),
    "bits": (8, 16),
}


@dataclasses.dataclass(frozen=True)
class Address:
    """A URL that was read.

    Attributes:
        scheme: of `OPTIONS`.
        place: device file, or host.
        port: of the host; 0 for device files.
        options: from behind the question mark.
        path: on the host, of ws alone.
    """

    scheme: str
    place: str
    port: int
    options: Options
    path: str = ""

    @property
    def worst_s(self) -> float:
        """After so long a request has failed, or its light has settled."""
        return self.options.worst_s

    def __str__(self) -> str:
        return self.place if not self.port else f"{self.place}:{self.port}"


def parse_leds(text: str) -> dict[str, Address]:
    """Read what `--leds` gives: one URL, or one of each controller: ``NAME=URL,NAME=URL``.

    Returns:
        Addresses by the controllers' names; a URL without a name under the empty one.

    Raises:
        ConfigError: as `parse_url`; a name or a device twice.
    """
    if not re.match(_NAMED, text):
        return {"": parse_url(text)}
    found: dict[str, Address] = {}
    for part in re.split(f",(?={_NAMED})", text):
        name, _, url = part.partition("=")
        address = parse_url(url)
        if name in found or address in found.values():
            what = "name" if name in found else "device"
            raise ConfigError(
                "--leds", found=f"{part}: a {what} that is there already", expected="each once"
            )
        found[name] = address
    return found


def worst_answer_s(text: str) -> float:
    """Longest time that one request takes, whatever happens; `text` as of `parse_leds`.

    Several controllers are asked at the same time.
    """
    return max(address.worst_s for address in parse_leds(text).values())


def parse_url(url: str) -> Address:
    """Read the URL of an LED device (docs/led_wire.md).

    Raises:
        ConfigError: another scheme, an unknown key, or values out of range: all in one message.
    """
    try:
        parts = urllib.parse.urlsplit(url)
        host, port = parts.hostname or "", parts.port
        host.encode("idna")  # as the system's resolver does; it takes no empty part of a name
    except ValueError as error:
        raise ConfigError("--leds", found=f"{url!r} ({error})", expected=EXPECTED) from None
    cls = OPTIONS.get(parts.scheme)
    network = parts.scheme in ("socket", "sacn", "ws")
    path = urllib.parse.unquote(parts.path)
    empty = not host if network else not path.strip("/")
    misplaced = path.strip("/") if network else parts.netloc
    path_on_host = ""
    if parts.scheme == "ws":
        path_on_host, misplaced = parts.path, ""
        empty = not host or not re.fullmatch("/[!-~]+", path_on_host)
    if parts.scheme == "sacn":
        port = SACN_PORT if port is None else port
    unported = network and not port
    if cls is None or empty or misplaced or unported or parts.fragment or "@" in parts.netloc:
        raise ConfigError("--leds", found=repr(url), expected=EXPECTED)
    options = _options(cls, parts.query)
    if isinstance(options, SacnOptions) and options.interface and host != MULTICAST:
        raise ConfigError(
            "--leds", field="interface", found=f"a host, {host}", expected="multicast"
        )
    return Address(parts.scheme, host if network else path, port or 0, options, path_on_host)


def _options(cls: type[Options], query: str) -> Options:
    hints = typing.get_type_hints(cls)
    known = ", ".join(sorted(hints))
    problems: list[LightstageError] = []
    values: dict[str, object] = {}

    def fault(key: str, found: str, expected: str) -> None:
        problems.append(ConfigError("--leds", field=key, found=found, expected=expected))

    for key, text in urllib.parse.parse_qsl(query, keep_blank_values=True):
        if key not in hints:
            fault(key, "an unknown key", f"one of {known}")
        elif key in values:
            fault(key, "two values", "one")
        elif hints[key] is str:
            values[key] = text
        else:
            whole = hints[key] is int
            number = _number(text, whole)
            low, high = RANGES[key]
            if number is None or not low <= number <= high:
                fault(key, repr(text), f"a {'whole ' * whole}number from {low:g} to {high:g}")
            values[key] = number
    if not problems:
        options = make_config(cls, values, "--leds")
        problems += _unfit(options)
    if problems:
        raise one_error(problems)
    return options


def _number(text: str, whole: bool) -> float | int | None:
    try:
        return int(text) if whole else float(text)
    except ValueError:
        return None


def _unfit(options: Options) -> list[LightstageError]:
    """What is wrong with values that are not mere numbers."""
    found: list[tuple[str, str, str]] = []
    if isinstance(options, AdalightOptions):
        if not _lit(options.colour):
            found.append(("colour", options.colour, "RRGGBB, hexadecimal, not black"))
        if sorted(options.order) != ["b", "g", "r"]:
            found.append(("order", options.order, "rgb in any order"))
    if isinstance(options, SacnOptions):
        if options.bits not in (8, 16):
            found.append(("bits", str(options.bits), "8 or 16"))
        if options.interface and not re.fullmatch(r"\d+(\.\d+){3}", options.interface):
            found.append(("interface", options.interface, "an IPv4 address of this machine"))
    if isinstance(options, IclOptions):
        if options.lights not in ICL_LIGHTS:
            found.append(("lights", options.lights, f"one of {', '.join(ICL_LIGHTS)}"))
        for key, colour in (("rgb", options.rgb), ("white", options.white)):
            if not _lit(colour):
                found.append((key, colour, "RRGGBB, hexadecimal, not black"))
    return [
        ConfigError("--leds", field=key, found=repr(value), expected=expected)
        for key, value, expected in found
    ]


def _lit(colour: str) -> bool:
    """Whether a text is RRGGBB and not black."""
    return bool(re.fullmatch("[0-9a-fA-F]{6}", colour)) and int(colour, 16) > 0
