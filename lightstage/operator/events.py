"""A session's events, served as long as its capture runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from lightstage.operator.server import EventServer


class Writer(Protocol):
    """What serves events of it: lightstage.session.SessionWriter."""

    root: Path

    @property
    def listeners(self) -> list[Callable[[dict[str, Any]], None]]:
        """Called with each line of the journal that is on the disk."""

    def note(self, event: str, **facts: Any) -> Any:
        """Write a line."""


@contextlib.contextmanager
def serve_events(
    writer: Writer, request: Callable[[str, str], str | None]
) -> Iterator[EventServer]:
    """Serve a session's events as long as the block lasts; the journal names the socket.

    Args:
        writer: the session's, before another thread writes to it.
        request: called with what clients want done, such as Operator.request.
    """
    with EventServer(writer.root / "journal.jsonl", request) as server:
        writer.listeners.append(server.receive)
        try:
            writer.note("note", said="others can follow", socket=str(server.path))
            yield server
        finally:
            with contextlib.suppress(ValueError):  # the journal takes off one that failed
                writer.listeners.remove(server.receive)
