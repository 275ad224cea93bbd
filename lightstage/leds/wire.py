"""The LED device's wire as pure bytes: packets, their payloads, a reader. See docs/led_wire.md."""

from __future__ import annotations

import binascii
import dataclasses
import enum
import hashlib
import struct

import numpy as np
from cobs import cobs

from lightstage.counting import counted
from lightstage.leds.controller import Hello, level_steps
from lightstage.printable import printable

VERSION = 1
FULL = 65535
MAX_FRAME = 1 << 16
"""Bytes between two zeros beyond which the stream is noise and is thrown away."""


class Kind(enum.IntEnum):
    """Packet types."""

    ASK_HELLO = 0x01
    HELLO = 0x02
    SET = 0x10
    DARK = 0x11
    ASK_STATE = 0x12
    LIT = 0x20
    REFUSED = 0x2F


@dataclasses.dataclass(frozen=True)
class Packet:
    """One packet: type, sequence number (u16), payload."""

    kind: int
    sequence: int
    payload: bytes = b""


def crc16(data: bytes) -> int:
    """CRC-16/IBM-3740. Python's own crc_hqx has its polynomial; the seed is the difference."""
    return binascii.crc_hqx(data, 0xFFFF)


class WireError(ValueError):
    """Bytes that are no packet. Readers drop them in silence; the host sends again."""


def encode(packet: Packet) -> bytes:
    """A packet's bytes on the wire, with the closing zero."""
    body = struct.pack("<BBH", VERSION, packet.kind, packet.sequence) + packet.payload
    return bytes(cobs.encode(body + struct.pack("<H", crc16(body)))) + b"\0"


def decode(frame: bytes) -> Packet:
    """The packet from between two zeros; WireError when COBS, version or CRC is wrong."""
    try:
        decoded = bytes(cobs.decode(frame))
    except cobs.DecodeError as error:
        raise WireError(str(error)) from None
    if len(decoded) < 6:
        raise WireError(counted(len(decoded), "byte"))
    body, (checksum,) = decoded[:-2], struct.unpack("<H", decoded[-2:])
    if crc16(body) != checksum:
        raise WireError("CRC")
    version, kind, sequence = struct.unpack_from("<BBH", body)
    if version != VERSION:
        raise WireError(f"version {version}")
    return Packet(kind, sequence, body[4:])


class PacketReader:
    """Cuts a byte stream into packets.

    Attributes:
        dropped: frames that were no packet, so far.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self.dropped = 0

    def feed(self, data: bytes) -> list[Packet]:
        """Take bytes as they come; return the whole packets that they complete."""
        self._pending += data
        *frames, rest = self._pending.split(b"\0")
        if len(rest) > MAX_FRAME:
            self.dropped += 1
            rest = bytearray()
        self._pending = rest
        packets = []
        for frame in frames:
            if not frame:
                continue
            try:
                packets.append(decode(bytes(frame)))
            except WireError:
                self.dropped += 1
        return packets


def level_counts(levels: np.ndarray) -> np.ndarray:
    """Levels as the wire's 16-bit counts.

    Args:
        levels: (n,) in 0..1.

    Returns:
        (n,) uint16, 65535 for 1.

    Raises:
        DeviceError: NaN or out of range; a level is refused, never clipped.
    """
    return level_steps(levels, FULL).astype("<u2")


def set_payload(counts: np.ndarray) -> bytes:
    """SET's payload of (n,) counts: their number, then one count a lamp."""
    return struct.pack("<H", len(counts)) + counts.astype("<u2").tobytes()


def lit_payload(counts: np.ndarray) -> bytes:
    """LIT's payload for (n,) counts: their SHA-256."""
    return hashlib.sha256(counts.astype("<u2").tobytes()).digest()


def parse_hello(payload: bytes) -> Hello:
    """HELLO's fields; WireError when it is too short, no UTF-8, or a known field is no number.

    What is behind the firmware's text is divided by zero bytes: ``name=value``. Unknown names
    are skipped; a device that has nothing there has no watchdog that is known of.
    """
    if len(payload) < 6:
        raise WireError(f"a HELLO of {counted(len(payload), 'byte')}")
    boot_id, count = struct.unpack_from("<IH", payload)
    try:
        firmware, *fields = payload[6:].decode().split("\0")
    except UnicodeDecodeError as error:
        raise WireError(str(error)) from None
    values = dict(field.split("=", 1) for field in fields if "=" in field)
    watchdog_ms, pulse_hz = _positive(values, "watchdog_ms"), _positive(values, "pulse_hz")
    watchdog_s = None if watchdog_ms is None else watchdog_ms / 1e3
    return Hello(boot_id, count, printable(firmware), watchdog_s, pulse_hz)


def _positive(values: dict[str, str], name: str) -> float | None:
    """A field's number; None where it is missing."""
    if name not in values:
        return None
    try:
        value = float(values[name])
    except ValueError:
        value = 0.0
    if not 0 < value < 1e9:
        raise WireError(f"{name}={values[name]}")
    return value


def parse_refused(payload: bytes) -> str:
    """The content of a REFUSED, as text."""
    code = payload[0] if payload else 0
    known = {1: "unknown type", 2: "wrong lamp count", 3: "bad length"}
    reason = printable(payload[1:].decode(errors="replace"))
    return f"{known.get(code, f'code {code}')}: {reason}" if reason else known.get(code, f"{code}")
