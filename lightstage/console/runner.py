"""Commands that the page starts: each is a process of its own that outlives the page's server."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightstage.errors import CaptureError, LightstageError
from lightstage.formats.files import read_json, write_json
from lightstage.printable import printable_lines
from lightstage.ways import CONSOLE, READER

SCHEMA = "lightstage.console-job/1"
FOLDER = ".console"
"""Beside the sessions: jobs, their output, and the lock of the one console of a plan."""
INTERRUPTED = (130, -signal.SIGINT, -signal.SIGTERM)
"""Exit codes of a command that was stopped: in order, or before Python had started it."""
LOG_BYTES = 8192
"""Bytes of a command's output that are shown, from its end."""
FACTS_BYTES = 1 << 20
"""Bytes of the longest line of facts: a check of the devices has some hundred for each finding."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A command that was started.

    Attributes:
        kind: one of a kind runs at a time; ``stage`` uses lights and cameras.
        what: what it works on, in words, such as ``P07/neutral``.
        session: name of the session's folder.
        pid: its process's number.
        born: when that process began, in the kernel's ticks, since process numbers are reused.
        log: name of the file of its output.
    """

    kind: str
    what: str
    session: str
    pid: int
    born: int
    log: str


@dataclasses.dataclass(frozen=True)
class JobState:
    """The state of a job.

    Attributes:
        job: the command.
        running: whether its process lives.
        code: its exit code; None while it runs, and where another server started it.
        output: the end of its log; empty while it runs.
        ended_s: time.time() of its last output; 0 while it runs, and where it has no log.
        started_s: time.time() of its start.
    """

    job: Job
    running: bool
    code: int | None
    output: str
    ended_s: float = 0.0
    started_s: float = 0.0

    @property
    def stopped(self) -> bool:
        """Whether it ended because somebody stopped it."""
        return not self.running and self.code in INTERRUPTED

    @property
    def failed(self) -> bool:
        """Whether it ended with an error."""
        return not self.running and self.code not in (None, 0, *INTERRUPTED)


class Runner:
    """Starts commands of `lightstage` and knows their state, also after the server restarts.

    Args:
        folder: folder of the sessions; a folder for logs is made in it.
        cwd: working folder of the commands: relative paths mean the same as to the server.
    """

    def __init__(self, folder: Path, cwd: Path) -> None:
        self._folder = folder / FOLDER
        self._cwd = cwd
        self._lock = threading.Lock()
        self._children: dict[int, subprocess.Popen[bytes]] = {}

    def start(self, kind: str, what: str, session: str, words: Sequence[str]) -> Job:
        """Start `lightstage WORDS` in a process that signals to this one do not reach.

        Raises:
            CaptureError: another one of this kind runs.
            OSError, LightstageError: what runs cannot be written; then it is stopped again.
        """
        with self._lock:
            running = self._state(kind)
            if running is not None and running.running:
                raise CaptureError(
                    running.job.what,
                    found="it is running already",
                    expected="one at a time",
                    hint="Wait for its end, or stop it.",
                )
            self._folder.mkdir(parents=True, exist_ok=True)
            log = self._folder / f"{kind}.log"
            with log.open("wb") as file:
                child = subprocess.Popen(
                    [sys.executable, "-m", "lightstage", *words],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    cwd=self._cwd,
                    start_new_session=True,
                    env={**os.environ, "TERM": "dumb", "COLUMNS": "200", READER: CONSOLE},
                )
            self._children[child.pid] = child
            job = Job(kind, what, session, child.pid, born(child.pid) or 0, log.name)
            try:
                write_json(self._path(kind), {"schema": SCHEMA, **dataclasses.asdict(job)})
            except BaseException:
                # Nobody could see or stop it, and a second one would be started beside it.
                child.terminate()
                raise
            return job

    def state(self, kind: str) -> JobState | None:
        """The state of the last command of a kind; None where there was none."""
        with self._lock:
            return self._state(kind)

    def stop(self, kind: str) -> bool:
        """Make a running command end in order (lights dark); whether there was one."""
        state = self.state(kind)
        if state is None or not state.running:
            return False
        with contextlib.suppress(ProcessLookupError):
            os.kill(state.job.pid, signal.SIGTERM)
        return True

    def output(self, job: Job, most: int = LOG_BYTES) -> str:
        """The end of a command's output; empty where there is none."""
        try:
            with (self._folder / job.log).open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                file.seek(max(0, size - most))
                return printable_lines(file.read().decode(errors="replace").strip(), most)
        except OSError:
            return ""

    def facts(self, job: Job) -> str:
        """The whole last line of a command's output, in which `--json` has its facts."""
        return self.output(job, FACTS_BYTES).rpartition("\n")[2]

    def _path(self, kind: str) -> Path:
        return self._folder / f"{kind}.json"

    def _state(self, kind: str) -> JobState | None:
        try:
            value: Any = read_json(self._path(kind), SCHEMA)
            job = Job(**{f.name: value[f.name] for f in dataclasses.fields(Job)})
            lives = born(int(job.pid)) == job.born
            started_s = self._path(kind).stat().st_mtime
        except (LightstageError, KeyError, TypeError, ValueError, OSError):
            return None
        code = None
        child = self._children.get(job.pid)
        if child is not None:  # our child: poll also removes it from the list of processes
            code = child.poll()
            lives = code is None
        if lives:
            return JobState(job, True, code, "", started_s=started_s)
        try:
            ended_s = (self._folder / job.log).stat().st_mtime
        except OSError:
            ended_s = 0.0
        return JobState(job, False, code, self.output(job), ended_s, started_s)


def born(pid: int) -> int | None:
    """When a process began, in ticks since the computer started; None where it has ended."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    # The process's name may hold blanks and brackets: the fields begin after its last bracket.
    fields = text.rpartition(")")[2].split()
    return None if fields[0] in ("Z", "X") else int(fields[19])
