"""ICL's stage: lsserver on a WebSocket. It answers that a state is set, never that it is lit."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from lightstage.errors import DeviceError
from lightstage.leds import lsserver
from lightstage.leds.address import Address, IclOptions
from lightstage.leds.connection import lock_address, opened
from lightstage.leds.controller import Hello, LightLostError, level_steps
from lightstage.leds.guard import LastWill
from lightstage.leds.icl_lights import IclLights
from lightstage.leds.lsserver import Event, LsserverError, Reply
from lightstage.leds.unanswered import UnansweredLeds
from lightstage.leds.websocket import WebSocketLine, greeting, masked

POLL_S = 0.05
"""How long one read of the line may wait; what comes is returned at once."""
RECOVER_S = 10.0
"""A server that starts again is waited for so long."""
DARK_AGAIN_S = 5.0
"""So long where the lights are only to go out."""
WILL_NUMBER = (1 << 53) - 1
"""Number of the guardian's request; a capture's numbers stay far below."""


class IclLeds(UnansweredLeds):
    """The lights of ICL's stage (LedController): not acknowledged.

    Each state is one command that sets every fixture, so that no light is left from before, and
    none goes out between. Nothing is set until the first light or dark.

    Args:
        address: of the server; its options are IclOptions.
        light_count: channels that are driven, from the first on (`IclLights`).

    Raises:
        ConfigError: more channels than the stage has.
        DeviceError: nobody there, somebody else there, or in use by another program here.
    """

    def __init__(self, address: Address, light_count: int) -> None:
        assert isinstance(address.options, IclOptions)
        options = address.options
        where = f"lsserver at {address}"
        self._address = address
        self._timeout_s = options.timeout_s
        self._hurry = threading.Event()
        self._number = 0
        self._broken = self._cut = False
        self._set = False  # whether the mode is the one that this program has set
        self._other_mode: str | None = None
        super().__init__(where, light_count, "", options)
        self._lock = lock_address(f"tcp {address}")
        try:
            self._line = self._open()
            grid = self._ask_grid()
            self._lights = IclLights(grid, light_count, options)
        except BaseException:
            self.close()
            raise
        firmware = (
            f"lsserver, {grid[0]} x {grid[1]}, {options.lights} (does not report what is lit)"
        )
        self._hello = Hello(0, light_count, firmware)

    def confirm(self) -> None:
        """Set the state once more; LightLostError unless the server takes it."""
        with self._turn:
            self._send(self._repeats)

    def dark(self) -> None:
        """All emitters of the stage off, and Manual; another thread's request is given up for it.

        A connection that broke is opened again first: a server that starts again would light its
        animation.
        """
        self._hurry.set()
        with self._turn:
            self._hurry.clear()
            self._steps = np.zeros_like(self._steps)
            if self._broken or self._cut:
                self._connect_again(DARK_AGAIN_S)
            self._insist(lsserver.BLACK, self._repeats)

    def recover(self) -> Hello:
        """Connect again where the connection broke, and wait for a server that starts; then dark.

        Raises:
            DeviceError: nobody there, or a stage of another grid.
        """
        with self._turn:
            if self._broken or self._cut:
                self._connect_again(RECOVER_S)
            self._other_mode = None
            self.dark()
            return self._hello

    def last_will(self) -> LastWill:
        """Black and Manual, by a connection of its own."""
        handles = self._line.handles
        host, port = self._line.peer
        begin = greeting(self._address.place, self._address.port, self._address.path)
        black = masked(lsserver.encode_request(WILL_NUMBER, lsserver.BLACK))
        answer = lsserver.encode_ok(WILL_NUMBER)
        return LastWill(handles, ((black, None),), answer, connect=(host, port), greeting=begin)

    def close(self) -> None:
        """End the connection; the stage stays as it is."""
        if hasattr(self, "_line"):
            self._line.close()
        self._lock.close()

    def _to_steps(self, levels: np.ndarray) -> np.ndarray:
        return level_steps(levels, lsserver.FULL)

    def _to_levels(self, steps: np.ndarray) -> np.ndarray:
        return np.asarray(steps / lsserver.FULL)

    def _send(self, times: int) -> None:
        counts = self._lights.counts(self._steps)
        self._insist(lsserver.set_fixtures(counts) if counts.any() else lsserver.BLACK, times)
        if self._other_mode is not None:
            mode, self._other_mode = self._other_mode, None
            raise LightLostError(
                self._where,
                field="mode",
                found=f"{mode}, which another program has set",
                expected=f"{lsserver.MANUAL}, and nobody else at the stage",
            )

    def _insist(self, command: dict[str, Any], times: int) -> None:
        """Ask until "Ok" comes; a wrong answer is one of the attempts."""
        (name,) = command
        gives_way = command is not lsserver.BLACK
        failure: LightLostError | None = None
        for _ in range(times):
            try:
                reply = self._exchange(command, name, gives_way)
            except LightLostError as error:
                if self._broken or (gives_way and self._hurry.is_set()):
                    raise
                failure = error
                continue
            if reply is None:
                failure = self._silent(name, times)
            elif reply.response == lsserver.OK:
                self._set = True
                return
            else:
                found = (
                    f"refused ({reply.error})"
                    if reply.error
                    else lsserver.text_of_response(reply.response)
                )
                failure = self._lost(name, found, repr(lsserver.OK))
        assert failure is not None
        raise failure

    def _ask_grid(self) -> tuple[int, int]:
        """Arcs and lights of an arc; DeviceError where who answers is no lsserver."""
        found = ""
        for _ in range(self._repeats):
            try:
                reply = self._exchange(lsserver.GET_CONFIG, lsserver.GET_CONFIG)
                if reply is not None:
                    return lsserver.read_grid(reply.response)
                found = f"no answer in {self._timeout_s:g} s, asked {self._repeats} times"
            except LsserverError as error:
                found = str(error)
            except LightLostError as error:  # nothing was lit yet
                found = error.found
                if self._broken:
                    break
        raise DeviceError(
            self._where,
            found=found,
            expected="lsserver's answer to GetConfig",
            hint="Is it lsserver (0.4) that answers at this address?",
        )

    def _exchange(self, command: Any, name: str, gives_way: bool = False) -> Reply | None:
        """Send once and wait for the answer of the same number; None when none came in time.

        What gives way is given up when another thread wants the lights out.
        """
        self._number += 1
        number = self._number
        try:
            self._cut = True
            self._line.send(lsserver.encode_request(number, command))
            self._cut = False
            deadline = time.monotonic() + self._timeout_s
            while (left_s := deadline - time.monotonic()) > 0:
                found = None
                for data in self._line.receive(min(left_s, POLL_S)):
                    found = self._read(data, number, name) or found
                if found is not None:
                    return found
                if gives_way and self._hurry.is_set():
                    raise self._lost(
                        name, "given up after another thread put the lights out", "an answer"
                    )
        except OSError as error:
            self._broken = True
            raise self._lost(
                name,
                str(error),
                "a connection that stays open",
                "Did the server end, or was the cable pulled? The lights may be as last set, or "
                "its animation may run.",
            ) from None
        return None

    def _read(self, data: bytes, number: int, name: str) -> Reply | None:
        """The answer to this request; None for what is none: an event, a late answer."""
        expected = f"the answer to request {number}"
        try:
            message = lsserver.read_message(data)
        except LsserverError as error:
            raise self._lost(name, str(error), expected) from None
        if isinstance(message, Event):
            if self._set and message.mode not in (None, lsserver.MANUAL):
                self._other_mode = message.mode
            return None
        if message.number == number:
            return message
        if message.number is None:
            found = f"a request that the server could not read ({message.error})"
            raise self._lost(name, found, expected)
        if 0 < message.number < number:
            return None  # it came too late: the request was sent again meanwhile
        found = f"an answer to request {message.number}, which was never sent"
        raise self._lost(name, found, expected)

    def _open(self) -> WebSocketLine:
        address = self._address

        def connect() -> WebSocketLine:
            return WebSocketLine(
                self._where,
                address.place,
                address.port,
                address.path,
                self._timeout_s,
                self._lock,
            )

        return opened(connect, self._where)

    def _connect_again(self, wait_s: float) -> None:
        """Open the connection anew, for so long; DeviceError where nobody, or another stage, is."""
        self._line.close()
        self._set, self._other_mode = False, None
        until = time.monotonic() + wait_s
        while True:
            try:
                self._line = self._open()
                break
            except DeviceError:
                if time.monotonic() >= until:
                    raise
            time.sleep(POLL_S)
        self._broken = self._cut = False
        grid = self._ask_grid()
        if grid != self._lights.grid:
            raise DeviceError(
                self._where,
                field="grid",
                found=f"{grid[0]} x {grid[1]}",
                expected=f"{self._lights.grid[0]} x {self._lights.grid[1]}, as before",
            )

    def _silent(self, name: str, times: int) -> LightLostError:
        return self._lost(
            name,
            f"no answer in {self._timeout_s:g} s, asked {times} times",
            "an answer",
            "Is the server busy? A slower one's timeout_s is set in the URL.",
        )

    def _lost(self, field: str, found: str, expected: str, hint: str = "") -> LightLostError:
        return LightLostError(self._where, field=field, found=found, expected=expected, hint=hint)
