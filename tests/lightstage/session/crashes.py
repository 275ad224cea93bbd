"""A small session whose process dies before any one of its operations, as often as wanted.

Disk operations, camera operations and named steps are counted; the process dies before the chosen
one, and from then on nothing reaches the disk or a camera any more.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from lightstage.cameras.camera import CardFile, Download, Summary
from lightstage.errors import CaptureError, DeviceError
from lightstage.rig import Rig
from lightstage.session import SessionPlan, SessionWriter, reconcile

PATTERNS = ("full", "x+")
OPERATIONS = ("write", "fsync", "link", "unlink", "rename", "replace", "mkdir", "ftruncate")


class Crash(Exception):  # noqa: N818
    """The process is dead."""


class Life:
    """Counts operations and dies before one of them.

    Attributes:
        left: operations until it dies; None: it lives.
        done: operations so far.
    """

    def __init__(self, left: int | None = None) -> None:
        self.left = left
        self.done = 0

    def tick(self) -> None:
        """One operation is about to happen."""
        if self.left is not None and self.done >= self.left:
            raise Crash
        self.done += 1


@contextlib.contextmanager
def living(life: Life) -> Iterator[None]:
    """Let all disk operations of this process belong to a life; flushes take no time."""
    real = {name: getattr(os, name) for name in OPERATIONS}

    def counted(name: str) -> Callable[..., object]:
        def operation(*args: object, **more: object) -> object:
            life.tick()
            return None if name == "fsync" else real[name](*args, **more)

        return operation

    for name in OPERATIONS:
        setattr(os, name, counted(name))
    try:
        yield
    finally:
        for name, function in real.items():
            setattr(os, name, function)


def picture(pattern: str, camera: str, number: int) -> bytes:
    """A file that begins as a DNG does and says what it is a picture of; all are of one size."""
    head = b"II*\0\x08\0\0\0" + struct.pack("<HHHI4sI", 1, 50706, 1, 4, b"\x01\x04\0\0", 0)
    return head + f"{pattern}|{camera}|{number}".encode().ljust(64)


def label(data: bytes) -> tuple[str, str]:
    """Pattern and camera that a picture says."""
    pattern, camera, _ = data[26:].decode().split("|")
    return pattern, camera


class Camera:
    """A camera whose card outlives the process (what CameraDevice is for a session)."""

    def __init__(self, camera_id: str, body: Body, life: Life) -> None:
        self.id = camera_id
        self.body = body
        self.life = life

    def summary(self) -> Summary:
        self._reach()
        return Summary(serial=self.body.serial)

    def card(self) -> tuple[CardFile, ...]:
        self._reach()
        return tuple(CardFile(name, len(data)) for name, data in self.body.card.items())

    def trigger(self, pattern: str) -> CardFile:
        """Take a picture; it is on the card before anybody is told."""
        self.life.tick()
        file = self.body.expose(picture(pattern, self.id, len(self.body.exposed)))
        self.life.tick()
        return file

    def download(self, name: str, path: Path, _: str = "*") -> Download:
        self._reach()
        data = self.body.card[name]
        with path.open("xb", buffering=0) as file:
            file.write(data[:40])
            self.life.tick()
            file.write(data[40:])
        self.life.tick()
        return Download(len(data), hashlib.sha256(data).hexdigest(), 0.0)

    def delete(self, name: str, _: str = "*") -> None:
        self._reach()
        del self.body.card[name]
        self.life.tick()

    def _reach(self) -> None:
        self.life.tick()
        if self.body.unreachable:
            raise DeviceError(f"camera {self.id}", found="no answer", expected="an answer")


@dataclasses.dataclass
class Body:
    """What of a camera outlives a process.

    Attributes:
        serial: its number.
        card: its files.
        number: of its last file.
        exposed: every picture that it ever took in this session.
        unreachable: whether it is switched off.
    """

    serial: str
    card: dict[str, bytes] = dataclasses.field(default_factory=dict)
    number: int = 0
    exposed: list[bytes] = dataclasses.field(default_factory=list)
    unreachable: bool = False

    def expose(self, data: bytes) -> CardFile:
        """Put a picture on the card."""
        self.number += 1
        name = f"/DCIM/DSC_{self.number:04d}.DNG"
        self.card[name] = data
        self.exposed.append(data)
        return CardFile(name, len(data))

    def shoot_elsewhere(self, count: int) -> None:
        """Take pictures that are none of this session's."""
        for index in range(count):
            self.expose(picture("elsewhere", "nobody", index))
            self.exposed.pop()


@dataclasses.dataclass
class Desk:
    """A session's folder and the cameras' bodies: what is left when the process dies.

    Attributes:
        root: the session.
        rig: with the cameras.
        bodies: by camera id; each card holds one older picture.
        delete: whether photographs are deleted on the cards.
    """

    root: Path
    rig: Rig
    bodies: dict[str, Body]
    delete: bool = False

    @staticmethod
    def new(root: Path, rig: Rig, delete: bool = False) -> Desk:
        bodies = {camera.id: Body(camera.serial) for camera in rig.cameras}
        for body in bodies.values():
            body.shoot_elsewhere(1)
        return Desk(root, rig, bodies, delete)

    def live(self, left: int | None = None) -> int:
        """One process: begins or resumes the session and works until it is done or dies.

        Returns:
            How many operations it did.
        """
        life = Life(left)
        writer: SessionWriter | None = None
        with living(life):
            try:
                cameras = [Camera(name, body, life) for name, body in self.bodies.items()]
                writer = self._opened(cameras)
                if writer is not None:
                    self._work(writer, cameras)
            except Crash:
                pass
            finally:
                if writer is not None:
                    writer.close()
        return life.done

    def _opened(self, cameras: Sequence[Camera]) -> SessionWriter | None:
        cards = {camera.id: camera.card() for camera in cameras}
        serials = {camera.id: camera.body.serial for camera in cameras}
        if not (self.root / "journal.jsonl").exists():
            plan = SessionPlan(PATTERNS, "p1")
            return SessionWriter.new(self.root, self.rig, plan, cards, serials)
        try:
            writer = SessionWriter.resumed(self.root, self.rig)
        except CaptureError as error:
            if "finished" in str(error):
                return None
            raise
        try:
            writer.resume(cards, serials)
            reconcile(writer, cameras, delete=self.delete)
        except BaseException:
            writer.close()
            raise
        return writer

    def _work(self, writer: SessionWriter, cameras: Sequence[Camera]) -> None:
        for pattern, wanted in writer.state.wanted().items():
            takers = [camera for camera in cameras if camera.id in wanted]
            if takers:
                writer.lit(pattern, [0.5] * 8, acknowledged=True)
                takes = {c.id: writer.next_take(pattern, c.id) for c in takers}
                writer.trigger(pattern, takes)
                files = {camera.id: camera.trigger(pattern) for camera in takers}
                for camera in takers:
                    take, file = takes[camera.id], files[camera.id]
                    writer.exposed(pattern, take, camera.id, file)
                    incoming = writer.incoming(pattern, camera.id, take)
                    got = camera.download(file.name, incoming)
                    writer.keep(pattern, camera.id, take, incoming, file, got.sha256)
                    if self.delete:
                        writer.deleting(pattern, camera.id, file)
                        camera.delete(file.name)
                        writer.deleted(pattern, camera.id, file)
            writer.shot(pattern)
        writer.finish()
        writer.end()

    def photographs(self, folder: str) -> list[tuple[Path, bytes]]:
        """Files under ``frames`` or ``recovered``, hidden ones too."""
        paths = sorted(path for path in (self.root / folder).glob("**/*") if path.is_file())
        return [(path, path.read_bytes()) for path in paths]
