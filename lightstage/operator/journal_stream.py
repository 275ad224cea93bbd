"""The journal as a stream of events: whole lines with ids, as far as they are written."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lightstage.closing import Closing
from lightstage.errors import FormatError
from lightstage.formats.values import LINE, open_regular, parse_json

PIECE_BYTES = 1 << 16
"""Read at once; a line may be longer."""


class JournalTail(Closing):
    """Reads what a journal has gained since the last look, in a bounded piece of memory.

    Only lines that end are given: the last one may still be in the middle of being written, or was
    cut by a crash; where it is later removed or ended, reading continues rightly, since the place
    after the last whole line is kept. A line that is no JSON object (a cut one that a resumed
    capture ended) is passed over. A line without an id gets the one after the line before it.

    Args:
        path: journal.jsonl.

    Raises:
        FormatError: no such file, or no regular one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.last_id = 0
        self._file = open_regular(path, "the journal of a capture")
        self._place = 0

    def entries(self) -> Iterator[tuple[dict[str, Any], int, int]]:
        """Lines since the last look: each with the bytes of the file where it begins and ends."""
        pending = b""
        while piece := os.pread(self._file, PIECE_BYTES, self._place + len(pending)):
            *whole, pending = (pending + piece).split(b"\n")
            for raw in whole:
                begin = self._place
                self._place += len(raw) + 1
                line = self._parsed(raw)
                if line is not None:
                    yield line, begin, self._place
            if len(pending) > LINE.size_bytes:
                raise FormatError(self.path, found="a line without end", expected="whole lines")

    def read(self) -> list[dict[str, Any]]:
        """Lines since the last look."""
        return [line for line, _, _ in self.entries()]

    def close(self) -> None:
        """Let go of the file."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1

    def _parsed(self, raw: bytes) -> dict[str, Any] | None:
        try:
            line = parse_json(raw, "journal", LINE)
        except FormatError:
            return None
        if not isinstance(line, dict):
            return None
        number = line.get("id")
        if not isinstance(number, int) or isinstance(number, bool):
            number = line["id"] = self.last_id + 1
        self.last_id = max(self.last_id, number)
        return line
