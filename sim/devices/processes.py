"""Processes by Linux's /proc: who descends from whom, who is stopped."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

POLL_S = 0.01


@dataclasses.dataclass(frozen=True)
class Process:
    """One process.

    Attributes:
        pid: its id.
        parent: its parent's.
        state: ``T`` where it is stopped, ``Z`` where it is dead and not yet buried.
        command: its arguments.
    """

    pid: int
    parent: int
    state: str
    command: tuple[str, ...]


def process(pid: int) -> Process | None:
    """What is known of a process; None where there is none."""
    folder = Path("/proc") / str(pid)
    try:
        # The name in brackets may hold anything, brackets too.
        fields = (folder / "stat").read_text().rpartition(")")[2].split()
        command = (folder / "cmdline").read_bytes().decode().split("\0")
    except (OSError, UnicodeDecodeError):
        return None
    return Process(pid, int(fields[1]), fields[0], tuple(command))


def descendants(pid: int) -> list[Process]:
    """All processes that descend from one."""
    found = [process(int(name)) for name in os.listdir("/proc") if name.isdigit()]
    living = [each for each in found if each is not None]
    wanted, out = {pid}, []
    while new := [each for each in living if each.parent in wanted and each not in out]:
        out += new
        wanted = {each.pid for each in new}
    return out


def is_gone(pid: int) -> bool:
    """Whether a process has ended."""
    found = process(pid)
    return found is None or found.state == "Z"


def kill(pid: int) -> None:
    """SIGKILL, also to one that has ended already."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def wait_until(true: Callable[[], bool], timeout_s: float) -> bool:
    """Ask again and again; False where it is not so in the time."""
    until = time.monotonic() + timeout_s
    while not true():
        if time.monotonic() > until:
            return False
        time.sleep(POLL_S)
    return True
