"""Events of a running capture on a local socket, for terminals and pages of the same user.

A client sends lines of JSON. ``{"after": ID}`` asks for every line of the journal with a larger
id, those that are written already and then each new one, as the journal has them. ``{"do":
"retake"}`` (or ``accept``, ``abort``, ``pause``, ``resume``) asks for that in the operator's place
(``"pattern": "x+"`` beside it names the pattern that is taken again, or that an answer is about),
and is answered by ``{"answer": "retake", "accepted": true}`` or ``{"answer": "retake", "accepted":
false, "why": "no pattern is done yet"}``; an answer has no id. Socket and folder belong to the user
who captures (modes 0600 and 0700).

Nothing is queued for anybody: the journal on the disk is the queue, and each client is a place in
it. So a slow client costs a buffer of its own and no more, and a capture only reports how far the
journal is on the disk: no client sees a line that is not.
"""

from __future__ import annotations

import array
import bisect
import collections
import contextlib
import dataclasses
import json
import os
import selectors
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lightstage.closing import Closing
from lightstage.errors import FormatError
from lightstage.formats.values import LINE, parse_json
from lightstage.operator.journal_stream import JournalTail
from lightstage.operator.runtime import new_socket_path

ANSWER_LIMIT_BYTES = 4096
"""Longest request line; a client that sends a longer one is let go."""
BUFFER_BYTES = 1 << 16
"""What waits in memory for one client; where it is more, it is read from the journal later."""


@dataclasses.dataclass(frozen=True)
class EventConfig:
    """How events are served.

    Attributes:
        clients: at most so many at a time, so that files are left for the capture itself.
        last_words_s: at the end, clients that still read get this long to come to the last line.
    """

    clients: int = 128
    last_words_s: float = 1.0


class _Client:
    """One connection: what it asked for so far, and what is on its way to it."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.received = b""
        self.waiting = bytearray()
        self.after: int | None = None  # the last id it has; None before it asked for lines


class EventServer(Closing):
    """Serves a journal's lines and passes on what clients ask for.

    `receive` must be one of the journal's listeners, from before another thread writes to it.

    Args:
        journal: journal.jsonl, which exists; the lines that it has now are on the disk.
        request: called with what a client wants done and a pattern (or an empty text), from the
            server's thread; returns why not, or None where it is accepted.
        config: limits.

    Raises:
        FormatError: no journal.
        CaptureError: no folder for the socket.
    """

    def __init__(
        self,
        journal: Path,
        request: Callable[[str, str], str | None],
        config: EventConfig | None = None,
    ) -> None:
        self._config = config or EventConfig()
        self._request = request
        self._tail = JournalTail(journal)
        self._file = -1
        self._ids = array.array("q")  # plain numbers: a capture may have very many lines
        self._begins = array.array("q")
        self._ends = array.array("q")
        self._unsure: collections.deque[tuple[int, int, int]] = collections.deque()
        self._clients: dict[int, _Client] = {}
        self._closing = threading.Event()
        try:
            self._file = os.open(journal, os.O_RDONLY)
            self._look()
            self._durable = self._tail.last_id
            self.path = new_socket_path()
            self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self._listener.bind(str(self.path))
            os.chmod(self.path, 0o600)
            self._listener.listen(self._config.clients)
        except BaseException:
            self._tail.close()
            if self._file >= 0:
                os.close(self._file)
            raise
        self._listener.setblocking(False)
        # Sockets and not a pipe: one that is closed cannot be taken for another file.
        self._woken, self._waker = socket.socketpair()
        self._woken.setblocking(False)
        self._waker.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._serve, name="events", daemon=True)
        self._thread.start()

    def receive(self, line: dict[str, Any]) -> None:
        """A line is on the disk now; never waits."""
        self._durable = line["id"]
        self._wake()

    def close(self) -> None:
        """Give what is left to those who read, let them go, and remove the socket."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._wake()
        self._thread.join()
        for client in list(self._clients.values()):
            self._drop(client)
        self._selector.close()
        self._listener.close()
        self.path.unlink(missing_ok=True)
        self._tail.close()
        self._woken.close()
        self._waker.close()
        os.close(self._file)

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # full: it is awake already
            self._waker.send(b"!")

    def _serve(self) -> None:
        until_s = float("inf")
        while True:
            closing = self._closing.is_set()  # read once: lines before it are served
            if closing and until_s == float("inf"):
                until_s = time.monotonic() + self._config.last_words_s
                self._selector.unregister(self._listener)
            self._index()
            for client in list(self._clients.values()):
                self._feed(client)
            done = all(self._is_served(client) for client in self._clients.values())
            if closing and (done or time.monotonic() >= until_s):
                return
            wait_s = None if until_s == float("inf") else max(0.0, until_s - time.monotonic())
            for key, events in self._selector.select(wait_s):
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj is self._woken:
                    with contextlib.suppress(OSError):
                        self._woken.recv(4096)
                elif events & selectors.EVENT_READ:
                    self._hear(self._clients[key.fd])

    def _look(self) -> None:
        for line, begin, end in self._tail.entries():
            self._unsure.append((line["id"], begin, end))

    def _index(self) -> None:
        """Take up the lines that are on the disk."""
        durable = self._durable
        if not self._unsure or self._unsure[-1][0] < durable:
            self._look()
        while self._unsure and self._unsure[0][0] <= durable:
            number, begin, end = self._unsure.popleft()
            if not self._ids or number > self._ids[-1]:
                self._ids.append(number)
                self._begins.append(begin)
                self._ends.append(end)

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        connection.setblocking(False)
        if len(self._clients) >= self._config.clients:
            with contextlib.suppress(OSError):
                connection.send(_line({"answer": None, "accepted": False, "why": "too many"}))
            connection.close()
            return
        self._clients[connection.fileno()] = _Client(connection)
        self._selector.register(connection, selectors.EVENT_READ)

    def _hear(self, client: _Client) -> None:
        """Take what a client sends; a broken one is let go."""
        try:
            piece = client.connection.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            piece = b""
        if not piece:
            self._drop(client)
            return
        *whole, client.received = (client.received + piece).split(b"\n")
        for raw in whole:
            answer = self._answer(client, raw) if raw.strip() else None
            client.waiting += b"" if answer is None else _line(answer)
        if max(len(client.received), len(client.waiting) - BUFFER_BYTES) > ANSWER_LIMIT_BYTES:
            self._drop(client)  # endless, or asks without ever reading the answers

    def _answer(self, client: _Client, raw: bytes) -> dict[str, Any] | None:
        try:
            request = parse_json(raw, "request", LINE)
        except FormatError:
            request = None
        if isinstance(request, dict):
            after, do = request.get("after"), request.get("do")
            if isinstance(after, int) and not isinstance(after, bool):
                client.after = after
                return None
            if isinstance(do, str):
                pattern = request.get("pattern")
                why = self._request(do, pattern if isinstance(pattern, str) else "")
                no = {} if why is None else {"why": why}
                return {"answer": do, "accepted": why is None, **no}
        return {
            "answer": None,
            "accepted": False,
            "why": 'expected {"after": ID} or {"do": "retake"}',
        }

    def _feed(self, client: _Client) -> None:
        """Send what a client can take now; the rest stays in the journal."""
        try:
            while True:
                self._fill(client)
                if not client.waiting:
                    break
                sent = client.connection.send(client.waiting)
                del client.waiting[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        self._selector.modify(client.connection, wanted)

    def _fill(self, client: _Client) -> None:
        while len(client.waiting) < BUFFER_BYTES:
            place = self._next(client)
            if place is None:
                return
            begin, end = self._begins[place], self._ends[place]
            client.waiting += os.pread(self._file, end - begin, begin)
            client.after = self._ids[place]

    def _next(self, client: _Client) -> int | None:
        """Place in the index of the line that comes next for a client."""
        if client.after is None or not self._ids or client.after >= self._ids[-1]:
            return None
        return bisect.bisect_right(self._ids, client.after)

    def _is_served(self, client: _Client) -> bool:
        return not client.waiting and self._next(client) is None

    def _drop(self, client: _Client) -> None:
        if self._clients.pop(client.connection.fileno(), None) is not None:
            self._selector.unregister(client.connection)
            client.connection.close()


def _line(value: dict[str, Any]) -> bytes:
    return json.dumps(value).encode() + b"\n"
