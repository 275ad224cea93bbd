"""A session to write to, and cameras whose cards are in memory."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.cameras.camera import CardFile, Download, Summary
from lightstage.errors import DeviceError
from lightstage.session import SessionPlan, SessionWriter

PATTERNS = ("full", "x+")


@dataclasses.dataclass
class MemoryCamera:
    """A camera as the session sees it (CameraDevice, without what no session calls).

    Attributes:
        id: the rig's name.
        files: on its card, name to bytes, oldest first.
        serial: that it tells.
        unreachable: whether it fails whatever it is asked.
    """

    id: str
    files: dict[str, bytes] = dataclasses.field(default_factory=dict)
    serial: str | None = None
    unreachable: bool = False
    shots: int = 0

    def expose(self, data: bytes) -> CardFile:
        """Take a picture of this."""
        self.shots += 1
        name = f"/DCIM/100TEST/DSC_{self.shots:04d}.DNG"
        self.files[name] = data
        return CardFile(name, len(data))

    def summary(self) -> Summary:
        self._reach()
        return Summary(serial=self.serial)

    def card(self) -> tuple[CardFile, ...]:
        self._reach()
        return tuple(CardFile(name, len(data)) for name, data in self.files.items())

    def download(self, name: str, path: Path, _: str = "*") -> Download:
        self._reach()
        data = self.files[name]
        with path.open("xb") as file:
            file.write(data)
        return Download(len(data), hashlib.sha256(data).hexdigest(), 0.0)

    def delete(self, name: str, _: str = "*") -> None:
        self._reach()
        del self.files[name]

    def _reach(self) -> None:
        if self.unreachable:
            raise DeviceError(f"camera {self.id}", found="no answer", expected="an answer")


@pytest.fixture
def plan() -> SessionPlan:
    return SessionPlan(PATTERNS, "p1", "neutral", {name: [1.0] * 8 for name in PATTERNS})


@pytest.fixture
def writer(tmp_path, small_rig, plan):
    made = SessionWriter.new(tmp_path / "S", small_rig, plan, facts={"extra": 3})
    yield made
    made.close()


@pytest.fixture
def keep(dng) -> Callable[..., Path]:
    """Keep a photograph's bytes as a camera's take."""

    def kept(writer, pattern, camera, data, take=1, sha256=None, size=None, **facts):
        incoming = writer.incoming(pattern, camera, take)
        incoming.write_bytes(data)
        file = CardFile("DSC_0001.DNG", len(data) if size is None else size)
        sha256 = sha256 or hashlib.sha256(data).hexdigest()
        return writer.keep(pattern, camera, take, incoming, file, sha256, **facts)

    return kept


@pytest.fixture
def fill(keep, dng) -> Callable[..., None]:
    """Keep all photographs of patterns, and their shots."""

    def filled(writer, patterns=PATTERNS):
        for number, pattern in enumerate(patterns):
            writer.lit(pattern, [1.0] * 8, acknowledged=True)
            writer.trigger(pattern, {f"cam{index}": 1 for index in range(3)})
            for index in (2, 0, 1):
                data = dng(1000, seed=10 * number + index)
                file = CardFile(f"DSC_{number}.DNG", len(data))
                writer.exposed(pattern, 1, f"cam{index}", file)
                keep(writer, pattern, f"cam{index}", data)
            writer.shot(pattern)

    return filled


@pytest.fixture
def memory_camera() -> type[MemoryCamera]:
    return MemoryCamera
