"""What a device is sent when the capture has ended, and the process that sends it (guardian.py)."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from lightstage.errors import DeviceError

SCRIPT = Path(__file__).with_name("guardian.py")
PATIENCE_S = 10.0
GOODBYE_S = 2.0


@dataclasses.dataclass(frozen=True)
class LastWill:
    """What makes a device dark.

    Attributes:
        handles: file descriptors to be kept open; the first one carries the messages, unless they
            go by a connection of their own.
        messages: in order, to be sent again and again; for a network with host and port.
        answer: what comes back when it is dark; empty from a device that does not answer.
        rounds: how often all messages are sent where no answer can come.
        connect: host and port to which a connection of their own is opened for the messages, where
            one that ended in the middle of a message can carry no other.
        greeting: what begins such a connection; the messages follow when it was answered.
    """

    handles: tuple[int, ...]
    messages: tuple[tuple[bytes, tuple[str, int] | None], ...]
    answer: bytes = b""
    rounds: int = 3
    connect: tuple[str, int] | None = None
    greeting: bytes = b""


@runtime_checkable
class HasLastWill(Protocol):
    """A controller whose device another process can make dark."""

    def last_will(self) -> LastWill:
        """What it must send for that."""


@runtime_checkable
class HasLastWills(Protocol):
    """The same of several devices."""

    def last_wills(self) -> tuple[LastWill, ...]:
        """One of each device."""


def last_wills(lights: object) -> tuple[LastWill, ...]:
    """What makes each device of a controller dark; none where no other process can."""
    if isinstance(lights, HasLastWills):
        return lights.last_wills()
    return (lights.last_will(),) if isinstance(lights, HasLastWill) else ()


class Guardian:
    """The process that makes a device dark should this one be killed.

    It has a session of its own, so that what ends the capture's terminal does not end it.

    Args:
        will: what it sends.
        silence_s: a capture that has not reported for so long that it lives counts as dead.

    Raises:
        DeviceError: the process cannot be started.
    """

    def __init__(self, will: LastWill, silence_s: float) -> None:
        self._child = subprocess.Popen(
            [sys.executable, "-I", "-S", str(SCRIPT)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=will.handles,
            start_new_session=True,
        )
        settings = {
            "handle": will.handles[0],
            "messages": [(data.hex(), where) for data, where in will.messages],
            "answer": will.answer.hex(),
            "rounds": will.rounds,
            "connect": will.connect,
            "greeting": will.greeting.hex(),
            "silence_s": silence_s,
            "patience_s": PATIENCE_S,
        }
        assert self._child.stdout is not None
        ready = self._send(json.dumps(settings).encode() + b"\n") and self._child.stdout.read(1)
        if ready != b"r":
            self._child.kill()
            self._child.wait()
            raise DeviceError(
                "lights",
                field="guardian",
                found="a process that ended at once",
                expected="one that can make the lights dark if this one is killed",
            )

    @property
    def pid(self) -> int:
        """Its process number."""
        return self._child.pid

    @property
    def alive(self) -> bool:
        """Whether it watches; after a long silence it has put the lights out and ended."""
        return self._child.poll() is None

    def beat(self) -> None:
        """Report that this process lives."""
        self._send(b".")

    def goodbye(self) -> None:
        """The lights are dark: it ends, and gives the device back."""
        self._send(b"!")
        self._end(GOODBYE_S)

    def leave(self) -> None:
        """Close the pipe without a goodbye, so that the guardian turns the lights off."""
        self._end(PATIENCE_S + GOODBYE_S)

    def _send(self, data: bytes) -> bool:
        try:
            assert self._child.stdin is not None
            self._child.stdin.write(data)
            self._child.stdin.flush()
        except (OSError, ValueError):  # it has ended, or was dismissed by another thread
            return False
        return True

    def _end(self, wait_s: float) -> None:
        for pipe in (self._child.stdin, self._child.stdout):
            assert pipe is not None
            try:
                pipe.close()
            except OSError:
                continue
        try:
            self._child.wait(wait_s)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()


class Guardians:
    """One guardian of each device, as if they were one.

    Args:
        wills: of the devices, at least one.
        silence_s: as of `Guardian`.

    Raises:
        DeviceError: a process cannot be started; then none is left.
    """

    def __init__(self, wills: Sequence[LastWill], silence_s: float) -> None:
        self._each: list[Guardian] = []
        try:
            for will in wills:
                self._each.append(Guardian(will, silence_s))
        except BaseException:
            self.goodbye()
            raise

    @property
    def pids(self) -> tuple[int, ...]:
        """Their process numbers."""
        return tuple(each.pid for each in self._each)

    @property
    def alive(self) -> bool:
        """Whether all of them watch."""
        return all(each.alive for each in self._each)

    def beat(self) -> None:
        """Report that this process lives."""
        for each in self._each:
            each.beat()

    def goodbye(self) -> None:
        """All lights are dark: they end."""
        for each in self._each:
            each.goodbye()

    def leave(self) -> None:
        """Close all pipes without a goodbye, so that the guardians turn the lights off."""
        for each in self._each:
            each.leave()
