"""Which files are this shot's: libgphoto2's cameras report them late, twice or in another order."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

from lightstage.cameras.file_names import raw_first, stem
from lightstage.cameras.gphoto_link import BUSY, Link
from lightstage.counting import counted
from lightstage.errors import DeviceError

DRAIN_MS = 1
LONGEST_WAIT_MS = 250
"""A wait may outlast its time; asked for short ones, the whole stays near its deadline."""


class Events:
    """The queue of events of one connection.

    A file is a shot's when it is reported after its trigger and was not known before. After a shot
    that did not give all its files (`owed`), some of them may still come: the next one listens
    until the camera is quiet, and refuses more than one shot can have made.
    """

    def __init__(self) -> None:
        self._known: set[str] = set()
        self.owed = False

    def know(self, names: Iterable[str]) -> None:
        """These are on the card already: no later shot's."""
        self._known.update(names)

    def drain(self, link: Link) -> None:
        """Take what is in the queue, until the camera is quiet; never longer than its patience."""
        until = time.monotonic() + link.patience.drain_s
        while time.monotonic() < until:
            try:
                kind, data = link.camera.wait_for_event(DRAIN_MS)
            except link.library.GPhoto2Error:
                return  # the command that follows reports what is wrong
            if kind == link.library.GP_EVENT_FILE_ADDED:
                self._known.add(joined(data))
            if kind == link.library.GP_EVENT_TIMEOUT:
                return

    def files_of_shot(
        self, link: Link, first: str | None, wanted: int
    ) -> tuple[tuple[str, ...], float]:
        """Names of the shot's files, RAW first, and when the camera reported the first.

        Args:
            link: the camera, triggered.
            first: file that the trigger itself reported.
            wanted: how many files one shot makes.

        Raises:
            DeviceError: no file came, or more than one shot makes; what came stays on the card.
        """
        strict, self.owed = self.owed, True
        names: list[str] = [] if first is None else [first]
        exposed_s = time.monotonic()
        heard_s, complete = exposed_s, first is not None and wanted == 1
        until = exposed_s + link.patience.event_s
        while (now_s := time.monotonic()) < until:
            quiet = now_s - heard_s >= link.patience.quiet_s
            if (complete or quiet) and len(names) >= wanted and (quiet or not strict):
                break
            if complete and quiet and names:
                break  # it makes fewer files than by its settings
            kind, data = self._next(link, until)
            if kind == link.library.GP_EVENT_FILE_ADDED:
                name = joined(data)
                if name not in self._known and name not in names:
                    exposed_s = exposed_s if names else time.monotonic()
                    names.append(name)
                heard_s = time.monotonic()
            elif kind == link.library.GP_EVENT_CAPTURE_COMPLETE:
                complete, heard_s = True, time.monotonic()
        self._known.update(names)
        shots = {stem(name) for name in names}
        if len(shots) != 1:
            raise DeviceError(
                link.port,
                field="trigger",
                found=f"files of {counted(len(shots), 'shot')} ({', '.join(names)})"
                if shots
                else "no file",
                expected="the files of this shot",
                hint="They are still on the card; nobody knows which is this shot's."
                if shots
                else "Is its card full? Did it focus?",
            )
        self.owed = len(names) < wanted
        return tuple(sorted(names, key=raw_first)), exposed_s

    def _next(self, link: Link, until: float) -> tuple[int, Any]:
        left_ms = int(1e3 * (until - time.monotonic()))
        try:
            kind, data = link.camera.wait_for_event(max(1, min(left_ms, LONGEST_WAIT_MS)))
        except link.library.GPhoto2Error as error:
            if error.code != BUSY:
                raise link.failure("trigger", error) from None
            time.sleep(0.02)
            return link.library.GP_EVENT_TIMEOUT, None
        return kind, data


def joined(path: Any) -> str:
    """A CameraFilePath as one name."""
    return f"{path.folder.rstrip('/')}/{path.name}"
