"""The other end: follow a capture by its socket where it runs, by its journal where it does not."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lightstage.errors import CaptureError, FormatError
from lightstage.formats.values import LINE, parse_json
from lightstage.operator.journal_stream import JournalTail
from lightstage.operator.runtime import socket_answers
from lightstage.operator.words import text_of

LOOK_S = 0.1
"""How often `stop` is asked, and a journal without a socket is read."""
ANSWER_BYTES = 1 << 16
ANSWER_S = 10.0
"""Longest wait for an answer; going dark may take the time of a silent LED device."""


def follow(
    session: Path, stop: Callable[[], bool] = lambda: False, patience_s: float = 3.0
) -> Iterator[dict[str, Any]]:
    """Every line of a session's journal, each once and in order, as long as its capture runs.

    Args:
        session: its folder.
        stop: called often; true ends it.
        patience_s: a capture that has not yet named its socket is waited for so long.

    Raises:
        FormatError: no journal.
    """
    with JournalTail(session / "journal.jsonl") as tail:
        seen = _Seen()
        until_s = time.monotonic() + patience_s
        while True:
            for line in tail.read():
                yield from seen.new(line)
            if seen.over or seen.socket or time.monotonic() >= until_s or stop():
                break
            time.sleep(LOOK_S)
        if not seen.over and seen.socket:
            for line in _live(seen.socket, seen.last_id, stop):
                yield from seen.new(line)
            for line in tail.read() if not stop() else ():
                yield from seen.new(line)  # what was written while the socket closed


def ask(session: Path, do: str, pattern: str = "") -> str | None:
    """Ask a running capture for something; why not, or None where it is accepted.

    Args:
        session: its folder.
        do: ``retake``, ``accept``, ``abort``, ``pause`` or ``resume``.
        pattern: that is taken again, or that an answer is about; the latest where it is empty.

    Raises:
        FormatError: no journal.
        CaptureError: no capture runs there, or it does not answer.
    """
    with JournalTail(session / "journal.jsonl") as tail:
        seen = _Seen()
        for line in tail.read():
            list(seen.new(line))
    nobody = CaptureError(
        session,
        found="no capture that answers",
        expected="one that runs",
        hint="lightstage watch shows how it ended.",
    )
    if not seen.socket or seen.over:
        raise nobody
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        try:
            connection.connect(seen.socket)
            connection.settimeout(ANSWER_S)
            of = {"pattern": pattern} if pattern else {}
            connection.sendall(json.dumps({"do": do, **of}).encode() + b"\n")
            with connection.makefile("rb") as file:
                answer = parse_json(file.readline(ANSWER_BYTES), "answer", LINE)
        except (OSError, FormatError):
            raise nobody from None
    if not isinstance(answer, dict):
        raise nobody
    return None if answer.get("accepted") else text_of(answer, "why") or "it refused"


def answers(session: Path) -> bool:
    """Whether a capture runs in a session's folder now and can be asked."""
    try:
        with JournalTail(session / "journal.jsonl") as tail:
            seen = _Seen()
            for line in tail.read():
                list(seen.new(line))
    except FormatError:
        return False
    return bool(seen.socket) and not seen.over and socket_answers(Path(seen.socket))


class _Seen:
    """What was given already, and what the lines show of the capture's life."""

    def __init__(self) -> None:
        self.last_id = 0
        self.socket = ""
        self.over = False

    def new(self, line: dict[str, Any]) -> Iterator[dict[str, Any]]:
        if line["id"] <= self.last_id:
            return
        self.last_id = line["id"]
        event = line.get("event")
        if event == "resume":
            self.socket, self.over = "", False
        self.over = self.over or event in ("aborted", "end")
        self.socket = text_of(line, "socket") or self.socket
        yield line


def _live(path: str, after: int, stop: Callable[[], bool]) -> Iterator[dict[str, Any]]:
    """Lines from the socket until it closes; none where its process has ended."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        pending = b""
        with contextlib.suppress(ConnectionError, FileNotFoundError):
            connection.connect(path)  # waits where many come at once; without a wait it would fail
            connection.settimeout(LOOK_S)
            connection.sendall(json.dumps({"after": after}).encode() + b"\n")
            while not stop():
                try:
                    piece = connection.recv(1 << 16)
                except TimeoutError:
                    continue
                if not piece:
                    return
                *whole, pending = (pending + piece).split(b"\n")
                for raw in whole:
                    line = parse_json(raw, "journal", LINE)
                    if isinstance(line, dict) and isinstance(line.get("id"), int):
                        yield line
                if len(pending) > LINE.size_bytes:
                    raise FormatError(path, found="a line without end", expected="whole lines")
