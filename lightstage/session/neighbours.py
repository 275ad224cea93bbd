"""Photographs of the sessions beside one, by their bytes: none of them may enter this one."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from lightstage.errors import FormatError
from lightstage.formats.values import LINE, parse_json
from lightstage.session.opening import JOURNAL
from lightstage.session.photo_entry import packed

MAX_BYTES = 1 << 28
"""Bytes of one journal that are read, at most."""
_HASH = re.compile(rb'"sha256"\s*:\s*"([0-9a-f]{64})"')
_SESSION = re.compile(rb'"session"\s*:\s*("(?:[^"\\]|\\.)*")')


class Neighbours:
    """Hashes of all photographs that the journals in the folders beside a session name.

    Journals are not parsed: a hash is found in one that is damaged, cut, or of a later version too,
    and hundreds of them take about a second. A copy of the session itself (a journal that began
    with the same session id) is no neighbour.

    Args:
        root: the session's folder; it need not be there yet. Where the folder above it cannot be
            listed, there are no neighbours.
    """

    def __init__(self, root: Path | None = None) -> None:
        self._journals: list[Path] = []
        self._places: dict[bytes, int] = {}  # hash to its journal's place in the list
        if root is None:
            return
        root = root.absolute()
        own = _session_of(_read(root / JOURNAL))
        folders: list[Path] = []
        with contextlib.suppress(OSError):
            folders = sorted(root.parent.iterdir())
        for folder in folders:
            data = b"" if folder.name == root.name else _read(folder / JOURNAL)
            if not data or (own and _session_of(data) == own):
                continue
            place = len(self._journals)
            self._journals.append(folder / JOURNAL)
            for found in _HASH.finditer(data):
                self._places.setdefault(packed(found[1].decode()), place)

    def __len__(self) -> int:
        """How many photographs are known."""
        return len(self._places)

    def whose(self, sha256: str) -> str | None:
        """Which photograph of which session has these bytes, in words; None for none."""
        place = self._places.get(packed(sha256))
        if place is None:
            return None
        journal = self._journals[place]
        for line in _read(journal).split(b"\n"):
            if sha256.encode() in line:
                return f"{_photograph(line)} in the session {journal.parent.name}"
        return f"a photograph in the session {journal.parent.name}"


def _read(path: Path) -> bytes:
    """A regular file's beginning; nothing where it is not there or does not let itself be read."""
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe must not hold a capture up
        try:
            if stat.S_ISREG(os.fstat(handle).st_mode):
                return b"".join(_pieces(handle))
        finally:
            os.close(handle)
    return b""


def _pieces(handle: int) -> Iterator[bytes]:
    left = MAX_BYTES
    while left > 0 and (piece := os.read(handle, min(left, 1 << 22))):
        left -= len(piece)
        yield piece


def _session_of(journal: bytes) -> bytes:
    """The session's id as the first line of a journal has it; empty where it has none."""
    found = _SESSION.search(journal.partition(b"\n")[0])
    return found[1] if found else b""


def _photograph(line: bytes) -> str:
    with contextlib.suppress(FormatError, KeyError, TypeError):
        fields = parse_json(line, "journal", LINE)
        if fields["event"] == "frame":
            return f"{fields['pattern']} by {fields['camera']}"
    return "a photograph"
