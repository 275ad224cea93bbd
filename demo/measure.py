"""Run a command as a user would, and report how long it took and how much memory it held."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

SAMPLE_S = 0.2
GRACE_S = 30.0


@dataclasses.dataclass(frozen=True)
class Measured:
    """What a command cost.

    Attributes:
        code: exit status; 128 + signal where a signal ended it.
        seconds: wall time.
        peak_mb: the largest resident memory of the command and all processes under it together,
            sampled five times a second (pages that processes share count once for each), and at
            least the peak that the system kept for the largest single one of them.
    """

    code: int
    seconds: float
    peak_mb: float


def run_measured(command: Sequence[str]) -> Measured:
    """Run a command to its end; its output is passed through.

    The command has a process group of its own, so that Ctrl-C and SIGTERM reach it once, from
    here: it is interrupted, waited for, and KeyboardInterrupt continues. What does not end within
    `GRACE_S` is killed.
    """
    start = time.perf_counter()
    process = subprocess.Popen(list(command), process_group=0)
    peak_kb = 0
    try:
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            peak_kb = max(peak_kb, tree_rss_kb(process.pid))
            time.sleep(SAMPLE_S)
    except KeyboardInterrupt:
        _stop(process.pid)
        process.returncode = 130
        raise
    code = os.waitstatus_to_exitcode(status)
    process.returncode = code
    return Measured(
        code=128 - code if code < 0 else code,
        seconds=time.perf_counter() - start,
        peak_mb=max(peak_kb, usage.ru_maxrss) / 1024,
    )


def _stop(pid: int) -> None:
    """Interrupt a process group, wait, kill what is left after the grace time."""
    with contextlib.suppress(ProcessLookupError, ChildProcessError):
        os.killpg(pid, signal.SIGINT)
        until = time.monotonic() + GRACE_S
        while time.monotonic() < until:
            if os.waitpid(pid, os.WNOHANG)[0]:
                return
            time.sleep(0.05)
        os.killpg(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def tree_rss_kb(root: int) -> int:
    """Resident memory in kB of a process and all its descendants that are alive."""
    parents: dict[int, int] = {}
    pages: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        # A process may end between the listing and the reading.
        with contextlib.suppress(OSError):
            # The name in brackets may hold anything; the fields after it are plain numbers.
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            parents[int(entry.name)] = int(fields[1])
            pages[int(entry.name)] = int(fields[21])
    mine = {root}
    grown = True
    while grown:
        more = {pid for pid, parent in parents.items() if parent in mine} - mine
        mine |= more
        grown = bool(more)
    return sum(pages.get(pid, 0) for pid in mine) * (os.sysconf("SC_PAGE_SIZE") // 1024)
