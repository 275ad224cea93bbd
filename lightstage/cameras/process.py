"""One supervised process a camera: killed at its deadline, found again by its serial number."""

from __future__ import annotations

import dataclasses
import math
import threading
import time
import weakref
from pathlib import Path
from typing import Any

from lightstage.cameras.camera import CardFile, Download, Exposure, Summary
from lightstage.cameras.child import Child
from lightstage.errors import ConfigError, DeviceError, LightstageError
from lightstage.printable import printable


@dataclasses.dataclass(frozen=True)
class Deadlines:
    """After how long a camera that has not answered is ended.

    Attributes:
        open_s: connecting; a camera that is to be restarted may need it at more than one port.
        absent_s: a camera that is to be restarted may be away, as after its cable was pulled.
        trigger_s: after the time at which it was to trigger, until its files are on the card.
        download_s: a download, beside the time that its bytes take.
        download_bytes_per_s: the slowest that a cable may be.
        other_s: settings, the list of its card, removing a file.
    """

    open_s: float = 30.0
    absent_s: float = 5.0
    trigger_s: float = 30.0
    download_s: float = 10.0
    download_bytes_per_s: float = 2e6
    other_s: float = 30.0

    def __post_init__(self) -> None:
        """ConfigError on a time that is none."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < math.inf:
                raise ConfigError(
                    "deadlines", field=field.name, found=repr(value), expected="a number over 0"
                )

    @staticmethod
    def all(seconds: float) -> Deadlines:
        """The same time for everything that a camera is asked; bytes take theirs on top."""
        return Deadlines(open_s=seconds, trigger_s=seconds, download_s=seconds, other_s=seconds)


LONGEST_NAME = 1000
"""Characters of a file's path on a card."""
UNKNOWN_BYTES = 100_000_000
"""Taken for the size of a file of which the camera has not reported it."""
PAUSE_S = 0.2
"""Pause between two searches for a camera that is not there."""


_CAMERAS: weakref.WeakSet[CameraProcess] = weakref.WeakSet()
"""All of this process: one that is searched for is not searched for where another one works."""


class CameraProcess:
    """A camera in a process of its own (CameraDevice).

    One command at a time; `close` may come from any thread, and ends what is under way.

    Args:
        camera_id: the rig's name for it.
        port: libgphoto2's name of the port, or what the driver calls it; `restart` may change it.
        virtual_folder: folder of libgphoto2's virtual camera, None for a real one.
        deadlines: of its commands; one number for all of them.
        driver: ``package.module:name`` of a driver that is not libgphoto2's.
    """

    def __init__(
        self,
        camera_id: str,
        port: str,
        virtual_folder: Path | None,
        deadlines: Deadlines | float,
        driver: str | None = None,
    ) -> None:
        self.id = camera_id
        self.port = port
        self.virtual_folder = virtual_folder
        self.deadlines = deadlines if isinstance(deadlines, Deadlines) else Deadlines.all(deadlines)
        self.driver = driver
        self._serial: str | None = None
        self._sizes: dict[str, int] = {}
        self._child: Child | None = None
        self._changing = threading.Lock()  # of _child and _closed
        self._closed = False
        _CAMERAS.add(self)

    @property
    def pid(self) -> int | None:
        """The process id, None before open() and after close()."""
        child = self._child
        return None if child is None else child.pid

    def open(self) -> Summary:
        """Start the process and connect, at the port alone."""
        self.close()
        self._closed = False
        self._serial = None
        summary = self._open_at(self.port, self.deadlines.open_s)
        self._serial = summary.serial
        return summary

    def restart(self) -> Summary:
        """End the process, find the same body again, and connect.

        A body that reported its serial number is searched at every port, its own first: a cable may
        be in another socket now. One that cannot report it is searched at its port alone. One
        that is away is waited for.

        Raises:
            DeviceError: it is not there, with what is at each port instead.
        """
        child = self._child
        if child is not None:
            child.kill()
        return self._search(self.deadlines.absent_s)

    def _search(self, absent_s: float) -> Summary:
        """Connect to the body with `_serial`, which may be away for some seconds."""
        absent_until = time.monotonic() + absent_s
        until = absent_until + self.deadlines.open_s
        answers: dict[str, str] = {}
        while not self._closed:
            for port in self._candidates(until):
                # Half of what is left: one port that hangs must not hide the others.
                left_s = max(PAUSE_S, 0.5 * (until - time.monotonic()))
                try:
                    summary = self._open_at(port, left_s, patient=False)
                except LightstageError as error:
                    answers[port] = str(error)
                    continue
                if summary.serial == self._serial:
                    self.port = port
                    return summary
                answers[port] = f"{port}: found serial {summary.serial}"
                self._end_child()
            if time.monotonic() + PAUSE_S >= absent_until:
                break
            time.sleep(PAUSE_S)
        known = f"the camera with serial {self._serial}" if self._serial else f"it at {self.port}"
        raise DeviceError(
            f"camera {self.id}",
            field="restart",
            found="; ".join([*answers.values(), *["closed"] * self._closed])
            or "no camera at any port",
            expected=known,
            hint="Check its cable, power and battery.",
        )

    def find(self, serial: str) -> Summary:
        """Connect to the body of a serial number at whatever port it is now, its own port first.

        Nobody waits for one that is away.

        Raises:
            DeviceError: it is not there, with what is at each port instead.
        """
        self.close()
        self._closed = False
        self._serial = serial
        return self._search(0.0)

    def summary(self) -> Summary:
        """The camera's summary, read anew."""
        return _summary(self._ask({"command": "summary"}, self.deadlines.other_s))

    def change(self, name: str, value: str) -> None:
        """Set a field of Summary by its name."""
        self._ask({"command": "change", "name": name, "value": value}, self.deadlines.other_s)

    def card(self) -> tuple[CardFile, ...]:
        """Every photograph on the card, oldest first."""
        return self._files(self._ask({"command": "card"}, self.deadlines.other_s))

    def trigger(self, at_s: float, pattern: str = "*") -> Exposure:
        """Trigger at a time of time.monotonic() and wait for the shot's files.

        Args:
            at_s: at once if it is past.
            pattern: whose light it is, for the names of steps.
        """
        lead_s = max(0.0, at_s - time.monotonic())
        command = {"command": "trigger", "at_s": at_s, "pattern": pattern}
        reply = self._ask(command, lead_s + self.deadlines.trigger_s)
        return Exposure(self._files(reply), reply["triggered_s"], reply["exposed_s"])

    def download(self, name: str, path: Path, pattern: str = "*") -> Download:
        """Write a card's file to `path`, which must not exist, and flush it to the disk.

        Args:
            name: of the file on the card.
            path: in a folder that exists.
            pattern: whose light it is, for the names of steps.

        Raises:
            CaptureError: this computer's disk fails; nothing is left at `path`.
        """
        size = self._sizes.get(name, UNKNOWN_BYTES)
        deadline_s = self.deadlines.download_s + size / self.deadlines.download_bytes_per_s
        command = {"command": "download", "name": name, "path": str(path), "pattern": pattern}
        return Download(**self._ask(command, deadline_s))

    def delete(self, name: str) -> None:
        """Remove a file from the card."""
        self._ask({"command": "delete", "name": name}, self.deadlines.other_s)
        self._sizes.pop(name, None)

    def close(self) -> None:
        """End the process; never raises, waits a few seconds at most."""
        with self._changing:
            self._closed = True
        self._end_child()

    def holds(self, port: str) -> bool:
        """Whether it is connected at this port now."""
        child = self._child
        return self.port == port and child is not None and child.alive

    def _end_child(self) -> None:
        with self._changing:
            child, self._child = self._child, None
        if child is not None:
            child.close()

    def _candidates(self, until: float) -> list[str]:
        """Ports at which the camera may be now, its own first, none that another one holds."""
        if self._serial is None:
            return [self.port]
        command = {**self._place(self.port), "command": "ports"}
        left_s = max(PAUSE_S, until - time.monotonic())
        try:
            found = [port for _, port in _ports(self.id, f"camera {self.id}", command, left_s)]
        except LightstageError:
            found = [self.port]
        others = [camera for camera in _CAMERAS if camera is not self]
        free = [port for port in found if not any(camera.holds(port) for camera in others)]
        return sorted(free, key=lambda port: port != self.port)

    def _open_at(self, port: str, deadline_s: float, patient: bool = True) -> Summary:
        """Connect in a new process, which is ended again where that fails."""
        with self._changing:
            if self._closed:
                raise DeviceError(f"camera {self.id}", found="closed", expected="open() first")
            child = self._child = Child(self.id, f"camera {self.id}")
        command = {**self._place(port), "command": "open", "patient": patient}
        try:
            return _summary(child.ask(command, deadline_s))
        except LightstageError:
            child.kill()
            raise

    def _place(self, port: str) -> dict[str, Any]:
        folder = None if self.virtual_folder is None else str(self.virtual_folder)
        return {"port": port, "virtual_folder": folder, "driver": self.driver}

    def _ask(self, command: dict[str, Any], deadline_s: float) -> dict[str, Any]:
        child = self._child
        if child is None:
            raise DeviceError(f"camera {self.id}", found="not open", expected="open() first")
        return child.ask(command, deadline_s)

    def _files(self, reply: dict[str, Any]) -> tuple[CardFile, ...]:
        files = tuple(CardFile(str(name), int(size)) for name, size in reply["files"])
        for file in files:
            if file.name != printable(file.name, LONGEST_NAME, squeeze=False):
                raise DeviceError(
                    f"camera {self.id}",
                    field="a file's name on the card",
                    found=printable(file.name),
                    expected=f"at most {LONGEST_NAME} printable characters",
                    hint="Rename or remove that file, or put in another card.",
                )
        self._sizes.update({file.name: file.size for file in files})
        return files


def detect_ports(deadline_s: float) -> list[tuple[str, str]]:
    """Model and port of every camera of libgphoto2, asked in a process that can be killed."""
    command = {"command": "ports", "port": "", "virtual_folder": None, "driver": None}
    return _ports("*", "camera detection", command, deadline_s)


def _ports(
    camera_id: str, name: str, command: dict[str, Any], deadline_s: float
) -> list[tuple[str, str]]:
    child = Child(camera_id, name)
    try:
        reply = child.ask(command, deadline_s)
    finally:
        child.close()
    return [(printable(model), str(port)) for model, port in reply["ports"]]


def _summary(reply: dict[str, Any]) -> Summary:
    """A camera's summary; its texts are shown, so they are made printable here."""
    fields: dict[str, Any] = {
        name: printable(value) if isinstance(value, str) else value for name, value in reply.items()
    }
    return Summary(**fields)
