"""The journal: an append-only file of one JSON object a line, each on the disk before it counts.

Every line has ``id`` (1, 2, ..; later lines have larger ones, and they alone give the order),
``time_utc`` (the computer's clock, which may be set back in the middle), ``elapsed_s`` (a steady
clock, from zero when this process opened the journal) and ``event``.

Threads that write at once share one flush (group commit): a thread of the journal's own writes and
flushes all that was handed in until then, while the writers wait for it. No signal interrupts it,
so Ctrl-C never leaves half a line.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import json
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lightstage.errors import CaptureError, FormatError
from lightstage.formats.files import fsync_path
from lightstage.session.disk import disk_errors, rename_new
from lightstage.session.events import Line
from lightstage.session.reading import SCHEMA, read_journal
from lightstage.steps import step

Listener = Callable[[Line], None]


def utc_now() -> str:
    """The time as ISO 8601 in UTC, to the millisecond."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


class Journal:
    """Writes a journal; several threads may. Made by `new` or `resumed`.

    While one is open, nobody else can open the same file: a second capture or resume of one folder
    is refused.

    Attributes:
        path: the file.
        book: called with each line that is on the disk, before the listeners.
        listeners: called with each line in the order of ids, after it is on the disk and before
            `write` returns, one at a time; they must be quick and must not write. One that raises
            is taken off and put into `broken_listeners` with what it raised.
    """

    def __init__(self, path: Path, handle: int) -> None:
        self.path = path
        self.book: Listener = _nobody
        self.listeners: list[Listener] = []
        self.broken_listeners: list[tuple[Listener, Exception]] = []
        self._handle = handle
        self._begun_s = time.monotonic()
        self._id = self._durable = 0
        self._torn = False
        self._first: str | None = None
        self._state = threading.Condition()
        self._waiting: list[Line] = []
        self._closing = False
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._serve, name="journal", daemon=True)
        self._thread.start()

    @staticmethod
    def new(path: Path, prepare: Callable[[], object], **facts: Any) -> tuple[Journal, Line]:
        """Make a journal that begins with the event ``begin``: it appears with it, or not at all.

        Args:
            path: of a file that is not there yet, in a folder that is.
            prepare: called when nobody else can begin here any more.
            facts: of the first line; the schema is added.

        Returns:
            The journal, locked, and its first line.

        Raises:
            CaptureError: there is one already, or the disk refuses.
        """
        beside = path.with_name(begun_name(path))
        with disk_errors(path):
            # One that was left by a crash before its first line was whole is used again.
            handle = os.open(beside, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
        journal = Journal(beside, handle)
        try:
            journal._lock_file(path)
            with disk_errors(path):
                if path.exists():
                    beside.unlink()
                    raise _taken(path)
                os.ftruncate(handle, 0)
                prepare()
            journal._first = "begin"
            line = journal.write("begin", schema=SCHEMA, **facts)
            with disk_errors(path):
                rename_new(beside, path)
                fsync_path(path.parent)
        except BaseException:
            journal.close()
            raise
        journal.path = path
        return journal, line

    @staticmethod
    def resumed(path: Path) -> tuple[Journal, list[Line]]:
        """Open a journal to resume it; its next event must be ``resume``.

        Returns:
            The journal, locked, and the lines that are in it.

        Raises:
            CaptureError: another process has it open, or the disk refuses.
            FormatError: none, damaged, or of a version without card snapshots.
        """
        if not path.is_file():
            raise FormatError(
                path,
                found="no such file",
                expected="the journal of a capture",
                hint="Nothing was begun here: capture without --resume.",
            )
        with disk_errors(path):
            handle = os.open(path, os.O_RDWR | os.O_APPEND)
        journal = Journal(path, handle)
        try:
            journal._lock_file(path)
            lines = read_journal(path)
            if lines[0]["schema"] != SCHEMA:
                raise FormatError(
                    path,
                    field="schema",
                    found=repr(lines[0]["schema"]),
                    expected=repr(SCHEMA),
                    hint="It was written by an older version, which could not resume.",
                )
            with disk_errors(path):
                size = os.fstat(handle).st_size
                journal._torn = os.pread(handle, 1, size - 1) != b"\n"
        except BaseException:
            journal.close()
            raise
        journal._id = journal._durable = lines[-1]["id"]
        journal._first = "resume"
        return journal, lines

    @property
    def torn(self) -> bool:
        """Whether the last line was cut by a crash (until the next is written)."""
        return self._torn

    def write(self, event: str, *, last: bool = False, **facts: Any) -> Line:
        """Append one event; returns its line when it is on the disk.

        Args:
            event: its name.
            last: whether a later write of any thread is an error.
            facts: beside it.

        Raises:
            CaptureError: the disk refused; the line is not in the journal, and what was before is.
            ValueError: a fact that JSON cannot hold, such as NaN.
        """
        json.dumps(facts, allow_nan=False)  # before it gets a place among others
        if threading.current_thread() is self._thread:
            raise RuntimeError("a listener of the journal must not write to it")
        with self._state:
            self._require_open()
            if self._first not in (None, event):
                raise CaptureError(
                    self.path, found=f"the event {event}", expected=f"first {self._first}"
                )
            self._first = None
            self._id += 1
            line: Line = {
                "id": self._id,
                "event": event,  # also half a line shows what it was to be
                "time_utc": utc_now(),
                "elapsed_s": round(time.monotonic() - self._begun_s, 6),
                **facts,
            }
            self._waiting.append(line)
            self._closing = self._closing or last
            self._state.notify_all()
            while self._durable < line["id"]:
                if self._failure is not None:
                    raise self._failure
                self._state.wait()
        return line

    def close(self) -> None:
        """Close the file when what was handed in is on the disk; a later write is an error."""
        with self._state:
            self._closing = True
            self._state.notify_all()
        self._thread.join()
        if self._handle >= 0:
            os.close(self._handle)
        self._handle = -1

    def _require_open(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._closing:
            raise CaptureError(self.path, found="a journal that was closed", expected="open")

    def _serve(self) -> None:
        """Write and flush what waits, all of it at once, until the journal is closed or fails."""
        while True:
            with self._state:
                while not self._waiting and not self._closing:
                    self._state.wait()
                batch, self._waiting = self._waiting, []
            if not batch:
                return
            failure: Exception | None = None
            try:
                self._put(batch)
                for line in batch:
                    self.book(line)
                    self._notify(line)
            except Exception as error:  # whatever it is, those who wait must learn of it
                failure = error
            with self._state:
                if failure is None:
                    self._durable = batch[-1]["id"]
                else:
                    self._failure = failure
                self._state.notify_all()
            if failure is not None:
                return

    def _put(self, batch: list[Line]) -> None:
        """Write whole lines; where the disk refuses, no part of them stays."""
        with disk_errors(self.path):
            begun = os.fstat(self._handle).st_size
            try:
                if self._torn:
                    _write(self._handle, b"\n")  # the cut line stays as it is, on its own
                for line in batch:
                    data = json.dumps(line, allow_nan=False).encode() + b"\n"
                    half = len(data) // 2
                    _write(self._handle, data[:half])
                    step("line-half-written", line.get("pattern", "*"), line.get("camera", "*"))
                    _write(self._handle, data[half:])
                os.fsync(self._handle)
            except OSError:
                with contextlib.suppress(OSError):
                    os.ftruncate(self._handle, begun)
                    os.fsync(self._handle)
                raise
            here, named = os.fstat(self._handle), os.stat(self.path)
            if (here.st_dev, here.st_ino) != (named.st_dev, named.st_ino):
                raise CaptureError(
                    self.path,
                    found="another file in the journal's place",
                    expected="the journal that this capture writes",
                    hint="Put it back, then resume.",
                )
        self._torn = False

    def _notify(self, line: Line) -> None:
        for listener in list(self.listeners):
            try:
                listener(line)
            except Exception as error:  # a display that fails must not end a capture
                self.listeners.remove(listener)
                self.broken_listeners.append((listener, error))

    def _lock_file(self, path: Path) -> None:
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise CaptureError(
                path,
                found="another capture that is writing to this session",
                expected="one at a time",
                hint="End the other one first, or give another folder.",
            ) from None
        except OSError as error:
            raise CaptureError(
                path,
                found=f"a disk that cannot lock a file ({error.strerror})",
                expected="one that can, so that two captures cannot write one session",
                hint="Capture to a local disk.",
            ) from None


def begun_name(path: Path) -> str:
    """Name of a journal's file until its first line is whole."""
    return f".{path.name}.begun"


def _write(handle: int, data: bytes) -> None:
    """All of `data`; OSError where the disk takes only a part."""
    while data:
        data = data[os.write(handle, data) :]


def _nobody(_: Line) -> None:
    """Keeps no book."""


def _taken(path: Path) -> CaptureError:
    return CaptureError(
        path,
        found="a journal",
        expected="none yet",
        hint="Resume it by --resume, or give another folder.",
    )
