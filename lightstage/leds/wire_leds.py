"""Our own protocol on any line: requests, retries, acknowledgements, resets (docs/led_wire.md)."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections.abc import Callable

import numpy as np

from lightstage.closing import Closing
from lightstage.errors import DeviceError
from lightstage.leds import wire
from lightstage.leds.connection import BUSY_WAIT_S, Line, opened
from lightstage.leds.controller import Hello, LightLostError
from lightstage.leds.guard import LastWill
from lightstage.leds.wire import Kind, Packet, PacketReader

HELLO_TIMEOUT_S = 2.0
"""A board that resets when its port opens takes about as long to come up."""
HELLO_ATTEMPTS = 5
POLL_S = 0.05
"""How long one read of the line may wait; bytes that come are returned at once."""
RECOVER_S = 10.0
"""A cable that was pulled, or a board that starts again, is waited for so long."""


class WireLeds(Closing):
    """An LED device that acknowledges (LedController), on a line that `connect` opens.

    Args:
        where: its name in messages.
        connect: opens the line; called again by `recover` where the line broke.
        timeout_s: how long one attempt waits for its answer; nothing is repeated before it is over.
        attempts: how often a request is sent before the device counts as silent.
        pulse_hz: where the device does not report it itself.
        first_sequence: of the first request; random by default, since a device that saw this
            number last would take the request for a repetition.

    Raises:
        DeviceError: the line cannot be opened, or nobody answers HELLO?.
    """

    acknowledged = True

    def __init__(
        self,
        where: str,
        connect: Callable[[], Line],
        timeout_s: float = 2.0,
        attempts: int = 3,
        pulse_hz: float | None = None,
        first_sequence: int | None = None,
    ) -> None:
        self._where = where
        self._connect = connect
        self._timeout_s, self._attempts = timeout_s, attempts
        self._told_pulse_hz = pulse_hz
        self._turn = threading.RLock()
        self._hurry = threading.Event()
        self._reader = PacketReader()
        self._wanted: bytes | None = None
        random = secrets.randbelow(0xFFFF)
        self._sequence = random if first_sequence is None else first_sequence - 1
        self._boot_id: int | None = None
        self._cut = self._broken = False
        until = time.monotonic() + BUSY_WAIT_S
        while True:
            self._line = self._open()
            try:
                self._hello = self._ask_hello()
                return
            except BaseException:
                self.close()
                # Turned away: a host before may be on its way out.
                if not self._broken or time.monotonic() > until:
                    raise
            self._broken = self._cut = False
            time.sleep(POLL_S)

    @property
    def hello(self) -> Hello:
        """Who is there."""
        return self._hello

    @property
    def pulse_hz(self) -> float | None:
        """As in the address, else as the device reports."""
        return self._told_pulse_hz or self._hello.pulse_hz

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Set all lamps to (n,) levels and wait for LIT with the hash of exactly these."""
        counts = wire.level_counts(levels)
        with self._turn:
            self._wanted = wire.lit_payload(counts)
            self._expect_lit(Kind.SET, wire.set_payload(counts))
        return counts.astype(float) / wire.FULL

    def confirm(self) -> None:
        """Ask STATE?; LightLostError unless the lights are still as last set."""
        with self._turn:
            self._expect_lit(Kind.ASK_STATE, b"")

    def dark(self) -> None:
        """All lights off, acknowledged; another thread's request is given up for it."""
        self._hurry.set()
        with self._turn:
            self._hurry.clear()
            self._wanted = wire.lit_payload(np.zeros(self._hello.light_count, "<u2"))
            boot_id = self._boot_id
            try:
                self._expect_lit(Kind.DARK, b"")
            except LightLostError:
                if self._boot_id == boot_id:
                    raise
                # It was reset and has just reported it: once more to the one that came up.
                self._expect_lit(Kind.DARK, b"")

    def recover(self) -> Hello:
        """Open the line again if it broke, greet whoever is there, all lights off.

        Raises:
            DeviceError: nobody there, or a device with another number of lamps.
        """
        with self._turn:
            if self._broken:
                self._line.close()
                self._line = self._reopened()
                self._broken = self._cut = False
                self._reader = PacketReader()
            before, self._boot_id = self._hello, None
            hello = self._ask_hello()
            if hello.light_count != before.light_count:
                raise DeviceError(
                    self._where,
                    field="lamp count",
                    found=str(hello.light_count),
                    expected=f"{before.light_count}, as before",
                    hint="Another device answers now; is the cable in the right place?",
                )
            self._hello = hello
            self.dark()
            return hello

    def last_will(self) -> LastWill:
        """HELLO?, whatever its number is, and the DARK after it (docs/led_wire.md)."""
        first, second = 0xFFFE, 0xFFFF
        off = np.zeros(self._hello.light_count, "<u2")
        ask = wire.encode(Packet(Kind.ASK_HELLO, first)) + wire.encode(Packet(Kind.DARK, second))
        # The zero before ends what this process may have been in the middle of.
        answer = wire.encode(Packet(Kind.LIT, second, wire.lit_payload(off)))
        return LastWill(self._line.handles, ((b"\0" + ask, None),), answer)

    def close(self) -> None:
        """Close the line; lights stay as they are."""
        self._line.close()

    def _open(self) -> Line:
        return opened(self._connect, self._where)

    def _reopened(self) -> Line:
        until = time.monotonic() + RECOVER_S
        while True:
            try:
                return self._open()
            except DeviceError:
                if time.monotonic() > until:
                    raise
            time.sleep(POLL_S)

    def _ask_hello(self) -> Hello:
        """Send HELLO? under a new number each time: a device still booting misses the first."""
        wait_s = min(self._timeout_s, HELLO_TIMEOUT_S)
        # A device that is slow to light is as slow to answer what comes meanwhile.
        attempts = max(HELLO_ATTEMPTS, math.ceil(self._timeout_s / wait_s))
        for _ in range(attempts):
            reply = self._exchange(Packet(Kind.ASK_HELLO, self._next()), wait_s)
            if reply is not None and reply.kind == Kind.HELLO:
                try:
                    hello = wire.parse_hello(reply.payload)
                except wire.WireError as error:
                    raise DeviceError(
                        self._where,
                        field="HELLO",
                        found=str(error),
                        expected="boot id, lamp count, firmware as UTF-8",
                    ) from None
                self._boot_id = hello.boot_id
                return hello
        raise self._silent(f"{attempts} HELLO? of {wait_s:g} s each")

    def _expect_lit(self, kind: Kind, payload: bytes) -> None:
        """Ask until LIT comes with what is wanted; any state where nothing was set yet."""
        packet = Packet(kind, self._next(), payload)
        for _ in range(self._attempts):
            reply = self._exchange(packet, self._timeout_s)
            if reply is None:
                continue
            if reply.kind == Kind.REFUSED:
                raise DeviceError(
                    self._where,
                    field=kind.name,
                    found=f"refused ({wire.parse_refused(reply.payload)})",
                    expected="LIT",
                )
            wanted = reply.payload if self._wanted is None else self._wanted
            if reply.kind != Kind.LIT or reply.payload != wanted:
                raise LightLostError(
                    self._where,
                    field=kind.name,
                    found="lights that are not as they were set "
                    f"(type {reply.kind:#04x}, state {reply.payload.hex()[:12]}..)",
                    expected=f"the levels that were sent (LIT, state {wanted.hex()[:12]}..)",
                    hint="Check the device, then start again.",
                )
            self._wanted = wanted
            return
        raise self._silent(f"{self._attempts} {kind.name} of {self._timeout_s:g} s")

    def _exchange(self, packet: Packet, wait_s: float) -> Packet | None:
        """Send once and wait for the reply of the same sequence number; None when none came."""
        try:
            self._send(wire.encode(packet))
            deadline = time.monotonic() + wait_s
            while (left_s := deadline - time.monotonic()) > 0:
                replies = self._reader.feed(self._line.read(min(left_s, POLL_S)))
                self._require_same_boot(replies)
                for reply in replies:
                    if reply.sequence == packet.sequence:
                        return reply
                    if reply.kind == Kind.HELLO and packet.kind == Kind.ASK_HELLO:
                        return reply  # the unasked one of a board that has just come up
                if self._hurry.is_set() and packet.kind != Kind.DARK:
                    raise LightLostError(
                        self._where,
                        field="request",
                        found="given up after another thread put the lights out",
                        expected="an answer",
                    )
        except OSError as error:
            self._broken = True
            raise LightLostError(
                self._where,
                found=str(error),
                expected="a line that stays open",
                hint="Was the cable pulled? The lights may be as they were last set.",
            ) from None
        return None

    def _send(self, data: bytes) -> None:
        # A zero ends what an interrupt left half sent; the device drops it at once.
        data = b"\0" + data if self._cut else data
        self._cut = True
        self._line.write(data)
        self._cut = False

    def _require_same_boot(self, replies: list[Packet]) -> None:
        """LightLostError, once for each reset, when a HELLO among the replies has another boot."""
        if self._boot_id is None:
            return
        for reply in replies:
            if reply.kind != Kind.HELLO:
                continue
            try:
                found = wire.parse_hello(reply.payload).boot_id
            except wire.WireError:
                continue
            if found != self._boot_id:
                expected, self._boot_id = self._boot_id, found
                raise LightLostError(
                    self._where,
                    field="boot id",
                    found="another: the device was reset and is dark",
                    expected=f"{expected:#010x}",
                    hint="Check its power supply, then capture again.",
                )

    def _silent(self, tried: str) -> DeviceError:
        return LightLostError(
            self._where,
            found=f"no answer to {tried}",
            expected="an answer",
            hint="Check cable, power and baud rate; is a slower device's timeout_s in the URL?",
        )

    def _next(self) -> int:
        # 0 is the unasked HELLO's; the last two are kept for the last will.
        self._sequence = self._sequence % 0xFFFD + 1
        return self._sequence
