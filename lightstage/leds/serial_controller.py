"""LED device on a serial line: requests, retries, acknowledgements. The only file with pyserial."""

from __future__ import annotations

import dataclasses
import secrets
import time
import urllib.parse
from types import TracebackType

import numpy as np
import serial

from lightstage.errors import ConfigError, DeviceError
from lightstage.leds import wire
from lightstage.leds.controller import Hello
from lightstage.leds.wire import Kind, Packet, PacketReader

HELLO_TIMEOUT_S = 2.0
"""A board that resets when its port opens takes about as long to come up."""
HELLO_ATTEMPTS = 5
POLL_S = 0.05
"""How long one read of the port may block; bytes that come are seen at once."""


@dataclasses.dataclass(frozen=True)
class SerialAddress:
    """Where the device is.

    Attributes:
        port: device file.
        baud: line speed; without meaning on a pseudo-terminal.
        timeout_s: how long one attempt waits for its answer; nothing is repeated before it is over.
        attempts: how often a request is sent before the device counts as silent.
    """

    port: str
    baud: int = 921600
    timeout_s: float = 2.0
    attempts: int = 3

    @property
    def worst_s(self) -> float:
        """After which silence counts as failure."""
        return self.timeout_s * self.attempts


def parse_url(url: str) -> SerialAddress:
    """Read ``serial:///dev/ttyX?baud=..&timeout_s=..&attempts=..`` or ``pty:///dev/pts/N?..``.

    Raises:
        ConfigError: another scheme, an unknown key, or a value out of range.
    """
    expected = (
        "serial:///dev/ttyX?baud=..&timeout_s=..&attempts=.. or pty:///dev/pts/N?timeout_s=.."
    )
    parts = urllib.parse.urlsplit(url)
    if parts.scheme not in ("serial", "pty") or parts.netloc or not parts.path.strip("/"):
        raise ConfigError("--leds", found=repr(url), expected=expected)
    values: dict[str, float] = {}
    for key, text in urllib.parse.parse_qsl(parts.query, keep_blank_values=True):
        if key not in ("baud", "timeout_s", "attempts"):
            raise ConfigError("--leds", field=key, found="an unknown key", expected=expected)
        try:
            values[key] = float(text)
        except ValueError:
            values[key] = float("nan")
        if not 0 < values[key] < 1e7:
            raise ConfigError("--leds", field=key, found=repr(text), expected="a positive number")
    default = SerialAddress(parts.path)
    return SerialAddress(
        port=urllib.parse.unquote(parts.path),
        baud=int(values.get("baud", default.baud)),
        timeout_s=values.get("timeout_s", default.timeout_s),
        attempts=max(1, int(values.get("attempts", default.attempts))),
    )


class SerialLeds:
    """An LED device behind a serial port or a pseudo-terminal (LedController).

    Args:
        address: where it is.
        first_sequence: of the first request; random by default, since a device that saw this
            number last would take the request for a repetition.

    Raises:
        DeviceError: the port cannot be opened, or nobody answers HELLO?.
    """

    def __init__(self, address: SerialAddress, first_sequence: int | None = None) -> None:
        self.address = address
        self._where = f"LED device at {address.port}"
        self._reader = PacketReader()
        self._lit: bytes | None = None
        random = secrets.randbelow(0xFFFF)
        self._sequence = random if first_sequence is None else first_sequence - 1
        self._boot_id: int | None = None
        try:
            self._port = serial.Serial(
                address.port, address.baud, timeout=POLL_S, write_timeout=5.0, exclusive=True
            )
        except (serial.SerialException, ValueError, OSError) as error:
            raise DeviceError(
                self._where,
                found=str(error),
                expected="a port that opens",
                hint="Is the device plugged in, and no other program using it?",
            ) from None
        try:
            self._hello = self._ask_hello()
        except BaseException:
            self.close()
            raise

    @property
    def hello(self) -> Hello:
        """Who is there."""
        return self._hello

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Set all lights and wait for LIT with the hash of exactly these levels."""
        counts = wire.level_counts(levels)
        self._expect_lit(Kind.SET, wire.set_payload(counts), wire.lit_payload(counts))
        return counts.astype(float) / wire.FULL

    def confirm(self) -> None:
        """Ask STATE?; DeviceError unless the lights are still as last set."""
        self._expect_lit(Kind.ASK_STATE, b"", self._lit)

    def dark(self) -> None:
        """All lights off, acknowledged."""
        off = np.zeros(self._hello.light_count, "<u2")
        self._expect_lit(Kind.DARK, b"", wire.lit_payload(off))

    @property
    def acknowledged(self) -> bool:
        """Whether the device tells what is lit: it does."""
        return True

    @property
    def pulse_hz(self) -> float | None:
        """Not known."""
        return None

    def recover(self) -> Hello:
        """Greet again, dark."""
        self._boot_id = None
        self._hello = self._ask_hello()
        self.dark()
        return self._hello

    def close(self) -> None:
        """Close the port; lights stay as they are."""
        self._port.close()

    def __enter__(self) -> SerialLeds:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _ask_hello(self) -> Hello:
        """Send HELLO? under a new number each time: a device still booting misses the first."""
        wait_s = min(self.address.timeout_s, HELLO_TIMEOUT_S)
        for _ in range(HELLO_ATTEMPTS):
            reply = self._exchange(Packet(Kind.ASK_HELLO, self._next()), wait_s)
            if reply is not None and reply.kind == Kind.HELLO:
                try:
                    hello = wire.parse_hello(reply.payload)
                except wire.WireError as error:
                    raise DeviceError(
                        self._where,
                        field="HELLO",
                        found=str(error),
                        expected="boot id, light count, firmware as UTF-8",
                    ) from None
                self._boot_id = hello.boot_id
                return hello
        raise self._silent(f"{HELLO_ATTEMPTS} HELLO? of {wait_s:g} s each")

    def _expect_lit(self, kind: Kind, payload: bytes, expected: bytes | None) -> None:
        packet = Packet(kind, self._next(), payload)
        for _ in range(self.address.attempts):
            reply = self._exchange(packet, self.address.timeout_s)
            if reply is None:
                continue
            if reply.kind == Kind.REFUSED:
                raise DeviceError(
                    self._where,
                    field=kind.name,
                    found=f"refused ({wire.parse_refused(reply.payload)})",
                    expected="LIT",
                )
            if reply.kind != Kind.LIT or (expected is not None and reply.payload != expected):
                raise DeviceError(
                    self._where,
                    field=kind.name,
                    found=f"type {reply.kind:#04x}, state {reply.payload.hex()[:12]}..",
                    expected=f"LIT, state {(expected or b'').hex()[:12]}..",
                    hint="The lights are not as they were set; check the device, then start again.",
                )
            self._lit = reply.payload
            return
        raise self._silent(f"{self.address.attempts} {kind.name} of {self.address.timeout_s:g} s")

    def _exchange(self, packet: Packet, wait_s: float) -> Packet | None:
        """Send once and wait for the reply of the same sequence number; None when none came."""
        try:
            self._port.write(wire.encode(packet))
            deadline = time.monotonic() + wait_s
            while time.monotonic() < deadline:
                data = self._port.read(max(1, self._port.in_waiting))
                for reply in self._reader.feed(data):
                    if reply.kind == Kind.HELLO and self._is_reset(reply):
                        raise self._reset()
                    if reply.sequence == packet.sequence:
                        return reply
                    if reply.kind == Kind.HELLO and packet.kind == Kind.ASK_HELLO:
                        return reply  # the unasked one of a board that has just come up
        except (serial.SerialException, OSError) as error:
            raise DeviceError(
                self._where,
                found=str(error),
                expected="a line that stays open",
                hint="Was the cable pulled? The lights may be as they were last set.",
            ) from None
        return None

    def _is_reset(self, reply: Packet) -> bool:
        if self._boot_id is None:
            return False
        try:
            return wire.parse_hello(reply.payload).boot_id != self._boot_id
        except wire.WireError:
            return False

    def _reset(self) -> DeviceError:
        return DeviceError(
            self._where,
            field="boot id",
            found="another: the device was reset and is dark",
            expected=f"{self._boot_id:#010x}",
            hint="Check its power supply, then capture again.",
        )

    def _silent(self, tried: str) -> DeviceError:
        return DeviceError(
            self._where,
            found=f"no answer to {tried}",
            expected="an answer",
            hint="Check cable, power and baud rate; is a slower device's timeout_s in the URL?",
        )

    def _next(self) -> int:
        self._sequence = self._sequence % 0xFFFF + 1
        return self._sequence
