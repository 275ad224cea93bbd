"""The LED device's side of the wire (docs/led_wire.md): bytes in, bytes out. No port, no clock.

It decodes the bytes by itself; nothing here is shared with the driver that it answers.
"""

from __future__ import annotations

import dataclasses
import hashlib
import struct
from collections.abc import Callable

import numpy as np
from cobs import cobs

from sim.errors import SimError

VERSION = 1
HELLO_ASKED, HELLO, SET, DARK, STATE_ASKED, LIT, REFUSED = 0x01, 0x02, 0x10, 0x11, 0x12, 0x20, 0x2F
UNKNOWN_TYPE, WRONG_COUNT, BAD_LENGTH = 1, 2, 3
FULL_COUNT = 65535
MAX_PACKET = 1 << 18
"""A stream without a zero byte for so long is noise, and is forgotten."""
BEHIND = 1 << 15
"""A sequence number so far ahead of the last one, or more, is behind it."""
FIRMWARE = "lightstage-sim 1"


@dataclasses.dataclass(frozen=True)
class Shining:
    """What the lamps do on a command.

    Attributes:
        counts: (n,) uint16, what really shines.
        reported: (n,) uint16, what the device reports of it.
    """

    counts: np.ndarray
    reported: np.ndarray


def sound_lamps(commanded: np.ndarray) -> Shining:
    """Lamps that do what is commanded, (n,) counts."""
    return Shining(commanded, commanded)


class LedProtocol:
    """The device's side of the conversation.

    Args:
        light_count: lights that it drives.
        boot_id: changes with each reset.
        show: called with (n,) levels in 0..1 whenever what shines changes, before it is
            acknowledged.
        lamps: from (n,) commanded counts to what shines and what is reported of it.
        watchdog_s: in HELLO; whoever holds the clock calls `put_out` after it.

    Attributes:
        counts: (n,) uint16 that were commanded.
        heard: how many whole packets have come.
        lies: how many of the next acknowledgements report levels that nobody commanded.
    """

    def __init__(
        self,
        light_count: int,
        boot_id: int,
        show: Callable[[np.ndarray], None],
        lamps: Callable[[np.ndarray], Shining] = sound_lamps,
        watchdog_s: float | None = None,
    ) -> None:
        self._fields = "" if watchdog_s is None else f"\0watchdog_ms={1e3 * watchdog_s:g}"
        self.heard = 0
        self.counts = np.zeros(light_count, "<u2")
        self.boot_id = boot_id
        self.lies = 0
        self._show = show
        self._lamps = lamps
        self._shining = Shining(self.counts, self.counts)
        try:
            from crc import Calculator, Crc16
        except ImportError:
            raise SimError(
                "the simulated LED device",
                found="no package crc",
                expected="the extra `sim`",
                hint="pip install 'lightstage[sim]'.",
            ) from None
        self._crc = Calculator(Crc16.IBM_3740.value, optimized=True)
        self._pending = b""
        # The last number and its answer; nothing for LIT, which is made anew each time.
        self._last: tuple[int, bytes] | None = None

    def hello(self, sequence: int = 0) -> bytes:
        """A HELLO packet; sequence 0 is the one sent unasked after a reset."""
        payload = (
            struct.pack("<IH", self.boot_id, len(self.counts)) + (FIRMWARE + self._fields).encode()
        )
        return self._packet(HELLO, sequence, payload)

    def reset(self, boot_id: int) -> None:
        """Restart: dark, with another boot id; nothing is remembered."""
        self.boot_id = boot_id
        self._pending, self._last = b"", None
        self.counts = np.zeros_like(self.counts)
        self.refresh()

    def put_out(self) -> None:
        """Nobody has spoken for too long: all lights off."""
        self._light(np.zeros_like(self.counts))

    def refresh(self) -> None:
        """Let the lamps do what was commanded; they are shown when that changes what shines."""
        shining = self._lamps(self.counts)
        if not np.array_equal(shining.counts, self._shining.counts):
            self._show(shining.counts.astype(float) / FULL_COUNT)
        self._shining = shining

    def frames(self, data: bytes) -> list[bytes]:
        """Take bytes from the host; what was between zeros so far, empty frames left out."""
        *frames, rest = (self._pending + data).split(b"\0")
        self._pending = rest if len(rest) < MAX_PACKET else b""
        return [frame for frame in frames if frame]

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the host; returns the answers to the packets that are complete."""
        return b"".join(self.answer(frame) for frame in self.frames(data))

    def answer(self, frame: bytes) -> bytes:
        """The answer to one COBS frame; nothing to a damaged one, or one that came too late."""
        try:
            body = cobs.decode(frame)
        except cobs.DecodeError:
            return b""
        if len(body) < 6 or body[0] != VERSION:
            return b""
        (checksum,) = struct.unpack("<H", body[-2:])
        if self._crc.checksum(body[:-2]) != checksum:
            return b""
        self.heard += 1
        _, kind, sequence = struct.unpack("<BBH", body[:4])
        if self._last is not None:
            if self._last[0] == sequence:
                # Lamps may have changed by themselves since: what is lit is reported as it is now.
                return self._last[1] or self._lit(sequence)
            if kind != HELLO_ASKED and (sequence - self._last[0]) % 65536 >= BEHIND:
                return b""
        answer = self._handle(kind, sequence, body[4:-2])
        self._last = (sequence, answer)
        return answer or self._lit(sequence)

    def _handle(self, kind: int, sequence: int, payload: bytes) -> bytes:
        """Do what is asked; the answer, or nothing where it is LIT."""
        if kind == SET:
            return self._set(sequence, payload)
        if kind not in (HELLO_ASKED, DARK, STATE_ASKED):
            return self._refuse(sequence, UNKNOWN_TYPE, f"type {kind:#04x}")
        if payload:
            return self._refuse(sequence, BAD_LENGTH, f"{len(payload)} bytes, expected none")
        if kind == HELLO_ASKED:
            return self.hello(sequence)
        if kind == DARK:
            self._light(np.zeros_like(self.counts))
        return b""

    def _set(self, sequence: int, payload: bytes) -> bytes:
        if len(payload) < 2:
            return self._refuse(sequence, BAD_LENGTH, f"{len(payload)} bytes")
        (count,) = struct.unpack("<H", payload[:2])
        if count != len(self.counts):
            return self._refuse(sequence, WRONG_COUNT, f"{count} of {len(self.counts)} lights")
        if len(payload) != 2 + 2 * count:
            return self._refuse(sequence, BAD_LENGTH, f"{len(payload)} bytes for {count} lights")
        self._light(np.frombuffer(payload[2:], "<u2").copy())
        return b""

    def _light(self, counts: np.ndarray) -> None:
        self.counts = counts
        self.refresh()

    def _lit(self, sequence: int) -> bytes:
        reported = self._shining.reported.astype("<u2")
        if self.lies > 0:
            self.lies -= 1
            reported = np.bitwise_xor(reported, 1).astype("<u2")
        return self._packet(LIT, sequence, hashlib.sha256(reported.tobytes()).digest())

    def _refuse(self, sequence: int, code: int, reason: str) -> bytes:
        return self._packet(REFUSED, sequence, bytes([code]) + reason.encode())

    def _packet(self, kind: int, sequence: int, payload: bytes) -> bytes:
        body = struct.pack("<BBH", VERSION, kind, sequence) + payload
        return bytes(cobs.encode(body + struct.pack("<H", self._crc.checksum(body)))) + b"\0"
