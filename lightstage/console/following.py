"""A session as the page shows it: its journal's lines, and its present state.

All of it comes from the journal, so a server that starts again shows the same.
"""

from __future__ import annotations

import collections
import datetime
import threading
import time
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lightstage.checks.config import ChecksConfig
from lightstage.checks.sums import Sum, find_sums
from lightstage.console.warmth import Budget, Warmth, levels_of
from lightstage.errors import FormatError
from lightstage.formats.paths import path_inside
from lightstage.operator.journal_stream import JournalTail
from lightstage.operator.runtime import socket_answers
from lightstage.operator.view import View
from lightstage.operator.words import SIGNS, number_of, text_of
from lightstage.session.opening import JOURNAL
from lightstage.ways import PRESSED

ALIVE_S = 1.0
"""How often a running capture's socket is tried."""
GRACE_S = 5.0
"""Seconds within which a capture that has just begun writes its socket into the journal."""

Sound = str


class Photograph(NamedTuple):
    """The file of one photograph.

    Attributes:
        path: on the disk.
        take: its number, from 1.
        sha256: of its bytes.
    """

    path: Path
    take: int
    sha256: str


class Event(NamedTuple):
    """One line of the journal for the page.

    Attributes:
        id: of the line.
        data: what the page gets, as JSON.
    """

    id: int
    data: dict[str, Any]


class Followed:
    """One session; several threads may call.

    Args:
        root: its folder.
        kept: number of last lines that are kept for pages that reconnect.

    Attributes:
        max_misfit: the largest misfit of a sum of light that its checks allow, a share.

    Raises:
        FormatError: no journal.
    """

    def __init__(self, root: Path, kept: int) -> None:
        self.root = root
        self.view = View(str(root), PRESSED)
        self._tail = JournalTail(root / JOURNAL)
        weakref.finalize(self, self._tail.close)  # once no page needs it
        self._lock = threading.Lock()
        self._photographs: dict[tuple[str, str], Photograph] = {}
        self._warmth = Warmth()
        self._levels: dict[str, np.ndarray] = {}
        self._events: collections.deque[Event] = collections.deque(maxlen=kept)
        self.max_misfit = ChecksConfig().max_misfit_share
        self._socket = ""
        self._written_s = -float("inf")
        self._tried_s = -float("inf")
        self._live = False
        self._first = True
        self._still = False

    def close(self) -> None:
        """Close the journal."""
        self._tail.close()

    def update(self) -> None:
        """Read the journal's new lines, and test whether its capture still runs."""
        with self._lock:
            lines = self._tail.read()
            for line in lines:
                self._take_up(line)
            now = time.monotonic()
            if lines and not self._first:
                self._written_s = now
            elif self._first and not self._socket:  # it may have begun just now
                self._written_s = now - self._age_s()
            self._first = False
            if not self.view.over or self.view.phase == "gone":
                self._try(now)

    def _age_s(self) -> float:
        """Seconds since the journal was written."""
        try:
            return max(0.0, time.time() - (self.root / JOURNAL).stat().st_mtime)
        except OSError:
            return float("inf")

    def _try(self, now: float) -> None:
        if now - self._tried_s < ALIVE_S:
            return
        self._tried_s = now
        self._live = bool(self._socket) and socket_answers(Path(self._socket))
        if not self._live and now - self._written_s > GRACE_S:
            self.view.gone()

    def _take_up(self, line: Mapping[str, Any]) -> None:
        words = self.view.receive(line)
        event = text_of(line, "event")
        self._warmth.receive(line, self.view.pattern is not None and not self.view.unlit)
        if event in ("begin", "resume"):
            self._socket, self._still, self._live = "", False, False
            self.max_misfit = _max_misfit(line)
        self._socket = text_of(line, "socket") or self._socket
        if event in ("end", "aborted"):
            self._live = False
        if event == "frame":
            self._photograph(line)
        levels = levels_of(line) if event == "lit" else None
        if levels is not None:
            self._levels[text_of(line, "pattern")] = levels
        data = {
            "id": self.view.last_id,
            "event": event,
            "tone": words.tone,
            "sign": SIGNS[words.tone],
            "text": words.text,
            "todo": words.todo,
            "at": text_of(line, "time_utc")[11:19],
            "sound": self._sound(line, event),
        }
        self._events.append(Event(self.view.last_id, data))

    def _sound(self, line: Mapping[str, Any], event: str) -> Sound:
        """The page's sound: ``hold`` as light begins, ``done`` at the end, ``look`` for help."""
        if event == "lit" and not self._still:
            self._still = True
            return "hold"
        paused = event == "note" and text_of(line, "said").startswith("paused")
        if event == "asked" or paused:
            self._still = False
        if event == "end":
            return "done"
        refused = event == "finding" and text_of(line, "severity") == "refuse"
        return "look" if event in ("asked", "aborted") or refused else ""

    def _photograph(self, line: Mapping[str, Any]) -> None:
        pattern, camera = text_of(line, "pattern"), text_of(line, "camera")
        try:
            path = path_inside(self.root, line.get("path"), self.root / JOURNAL, "path")
        except FormatError:
            return  # a path that leads out of the folder: the photograph is not shown
        take = int(number_of(line, "take") or 1)
        shown = self._photographs.get((pattern, camera))
        if shown is not None and take < shown.take:
            return  # an older take may come home after the one that counts
        self._photographs[pattern, camera] = Photograph(path, take, text_of(line, "sha256"))

    def budget(self) -> Budget | None:
        """What its lights have used of their limits of heat and time until now."""
        with self._lock:
            return self._warmth.budget(datetime.datetime.now(datetime.UTC))

    @property
    def live(self) -> bool:
        """Whether its capture runs and accepts requests."""
        return self._live and not self.view.over

    def photograph(self, pattern: str, camera: str) -> Photograph | None:
        """The last take's photograph of a pattern by a camera."""
        return self._photographs.get((pattern, camera))

    def photographs_of(self, camera: str) -> list[tuple[str, Photograph]]:
        """A camera's photographs with their patterns, in the order in which they were taken."""
        return [(p, each) for (p, c), each in list(self._photographs.items()) if c == camera]

    def sum_of(self, pattern: str, camera: str) -> tuple[Sum, tuple[Photograph, ...]] | None:
        """Two patterns and the third that they sum to, of which one is this; all are photographed.

        Returns:
            The sum and its photographs in its order; None where this camera has none yet.
        """
        there = dict(self.photographs_of(camera))
        with self._lock:
            levels = {name: each for name, each in self._levels.items() if name in there}
        if len({len(each) for each in levels.values()}) > 1:
            return None  # a journal that was edited
        found = [each for each in find_sums(levels) if pattern in each.patterns]
        if not found:
            return None
        return found[0], tuple(there[name] for name in found[0].patterns)

    def after(self, number: int) -> list[Event]:
        """The lines after one of this id, as far as they are kept."""
        return [event for event in list(self._events) if event.id > number]


def _max_misfit(line: Mapping[str, Any]) -> float:
    """The limit of the checks that a line ``begin`` or ``resume`` has, else the default one."""
    config = line.get("config")
    checks = config.get("checks") if isinstance(config, dict) else None
    found = number_of(checks, "max_misfit_share") if isinstance(checks, dict) else None
    return ChecksConfig().max_misfit_share if found is None else found


class Following:
    """The sessions that pages show; the one that was shown longest ago is closed.

    Args:
        kept: number of last lines that are kept of each.
        most: number of sessions at a time.
    """

    def __init__(self, kept: int, most: int = 4) -> None:
        self._kept = kept
        self._most = most
        self._lock = threading.Lock()
        self._open: collections.OrderedDict[Path, tuple[int, Followed]] = collections.OrderedDict()

    def of(self, root: Path) -> Followed:
        """A session in its present state; FormatError where it has no journal."""
        try:
            inode = (root / JOURNAL).stat().st_ino
        except OSError:
            inode = -1
        with self._lock:
            known = self._open.pop(root, None)
            if known is not None and known[0] != inode:  # another journal of the same name
                known[1].close()
                known = None
            followed = Followed(root, self._kept) if known is None else known[1]
            self._open[root] = (inode, followed)
            # A request that still reads the oldest one holds it; its journal closes with it.
            while len(self._open) > self._most:
                self._open.popitem(last=False)
        followed.update()
        return followed
