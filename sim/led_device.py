"""The far end of the LED wire: a device behind a pseudo-terminal (docs/led_wire.md).

It decodes the bytes by itself; nothing here is shared with the driver that it answers.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import select
import struct
import threading
import time
import tty
from collections.abc import Callable
from types import TracebackType

import numpy as np
from cobs import cobs
from crc import Calculator, Crc16

VERSION = 1
HELLO_ASKED, HELLO, SET, DARK, STATE_ASKED, LIT, REFUSED = 0x01, 0x02, 0x10, 0x11, 0x12, 0x20, 0x2F
UNKNOWN_TYPE, WRONG_COUNT, BAD_LENGTH = 1, 2, 3
FULL_COUNT = 65535
MAX_PACKET = 1 << 18
"""A stream without a zero byte for so long is noise, and is forgotten."""
FIRMWARE = "lightstage-sim 1"


@dataclasses.dataclass(frozen=True)
class LitState:
    """What was lit from `at_s` on.

    Attributes:
        at_s: monotonic clock, when the lamps had settled and before it was acknowledged.
        counts: (n,) uint16 level of each light.
    """

    at_s: float
    counts: np.ndarray


class LedProtocol:
    """The device's side of the conversation: bytes in, bytes out. No port, no clock.

    Args:
        light_count: lights that it drives.
        boot_id: changes with each reset.
        show: called with (n,) levels in 0..1 whenever the state changes, before it is acknowledged.
    """

    def __init__(self, light_count: int, boot_id: int, show: Callable[[np.ndarray], None]) -> None:
        self.counts = np.zeros(light_count, "<u2")
        self.boot_id = boot_id
        self._show = show
        self._crc = Calculator(Crc16.IBM_3740.value, optimized=True)
        self._pending = b""
        self._last: tuple[int, bytes] | None = None

    def hello(self, sequence: int = 0) -> bytes:
        """A HELLO packet; sequence 0 is the one sent unasked after a reset."""
        payload = struct.pack("<IH", self.boot_id, len(self.counts)) + FIRMWARE.encode()
        return self._packet(HELLO, sequence, payload)

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the host; returns the answers to the packets that are complete."""
        *frames, rest = (self._pending + data).split(b"\0")
        self._pending = rest if len(rest) < MAX_PACKET else b""
        return b"".join(self._answer(frame) for frame in frames)

    def _answer(self, frame: bytes) -> bytes:
        """The answer to one COBS frame; nothing to a damaged one."""
        try:
            body = cobs.decode(frame)
        except cobs.DecodeError:
            return b""
        if len(body) < 6 or body[0] != VERSION:
            return b""
        (checksum,) = struct.unpack("<H", body[-2:])
        if self._crc.checksum(body[:-2]) != checksum:
            return b""
        _, kind, sequence = struct.unpack("<BBH", body[:4])
        if self._last is not None and self._last[0] == sequence:
            return self._last[1]
        answer = self._handle(kind, sequence, body[4:-2])
        self._last = (sequence, answer)
        return answer

    def _handle(self, kind: int, sequence: int, payload: bytes) -> bytes:
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
        return self._lit(sequence)

    def _set(self, sequence: int, payload: bytes) -> bytes:
        if len(payload) < 2:
            return self._refuse(sequence, BAD_LENGTH, f"{len(payload)} bytes")
        (count,) = struct.unpack("<H", payload[:2])
        if count != len(self.counts):
            return self._refuse(sequence, WRONG_COUNT, f"{count} of {len(self.counts)} lights")
        if len(payload) != 2 + 2 * count:
            return self._refuse(sequence, BAD_LENGTH, f"{len(payload)} bytes for {count} lights")
        self._light(np.frombuffer(payload[2:], "<u2").copy())
        return self._lit(sequence)

    def _light(self, counts: np.ndarray) -> None:
        if np.array_equal(counts, self.counts):
            return
        self._show(counts.astype(float) / FULL_COUNT)
        self.counts = counts

    def _lit(self, sequence: int) -> bytes:
        return self._packet(LIT, sequence, hashlib.sha256(self.counts.tobytes()).digest())

    def _refuse(self, sequence: int, code: int, reason: str) -> bytes:
        return self._packet(REFUSED, sequence, bytes([code]) + reason.encode())

    def _packet(self, kind: int, sequence: int, payload: bytes) -> bytes:
        body = struct.pack("<BBH", VERSION, kind, sequence) + payload
        return bytes(cobs.encode(body + struct.pack("<H", self._crc.checksum(body)))) + b"\0"


class LedDevice:
    """A LedProtocol at the master end of a pseudo-terminal, in a thread of its own.

    Use as a context manager. A new device is dark. What `show` raises is kept in `failure`, and
    the device falls silent: a lamp that did not settle is not acknowledged.

    Attributes:
        path: of the end that the host opens.
        states: what was lit, in order, the dark start included.
        failure: what `show` raised.
    """

    def __init__(
        self, light_count: int, show: Callable[[np.ndarray], None], boot_id: int = 1
    ) -> None:
        self._show = show
        self._protocol = LedProtocol(light_count, boot_id, self._settle)
        self.states = [LitState(time.monotonic(), self._protocol.counts)]
        self.failure: BaseException | None = None
        self._master, self._slave = os.openpty()
        # The host's end stays open here too: else the master reads an error until it is opened.
        tty.setraw(self._master)
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="led-device", daemon=True)

    def url(self, timeout_s: float, attempts: int = 1) -> str:
        """The device's address for `lightstage capture --leds`."""
        return f"pty://{self.path}?timeout_s={timeout_s:g}&attempts={attempts}"

    def __enter__(self) -> LedDevice:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.write(self._stop_write, b"x")
        self._thread.join()
        for handle in (self._master, self._slave, self._stop_read, self._stop_write):
            os.close(handle)

    def _settle(self, levels: np.ndarray) -> None:
        self._show(levels)
        counts = np.round(levels * FULL_COUNT).astype("<u2")
        self.states.append(LitState(time.monotonic(), counts))

    def _serve(self) -> None:
        os.write(self._master, self._protocol.hello())
        while True:
            ready, _, _ = select.select([self._master, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            try:
                answer = self._protocol.feed(os.read(self._master, 65536))
            except BaseException as failure:  # whatever it is, the owner must learn of it
                self.failure = failure
                return
            while answer:
                answer = answer[os.write(self._master, answer) :]
