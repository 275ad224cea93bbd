"""What tests of cameras share: virtual cameras' folders, and processes that are always closed."""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from pathlib import Path

import pytest

from lightstage.cameras.binding import close_cameras
from lightstage.cameras.process import CameraProcess

PORT = "usb:001,001"
HERE = Path(__file__).parent


class VirtualCameras:
    """Folders for libgphoto2's virtual camera, each with its seed."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.made: list[CameraProcess] = []

    def folder(self, name: str, data: bytes) -> Path:
        seed = self.root / name / "DCIM" / "100TEST" / "seed.jpg"
        seed.parent.mkdir(parents=True)
        seed.write_bytes(data)
        return self.root / name

    def camera(self, name: str, size: int = 40_000, deadline_s: float = 20.0) -> CameraProcess:
        folder = self.folder(name, os.urandom(size))
        self.made.append(CameraProcess(name, PORT, folder, deadline_s))
        return self.made[-1]

    @staticmethod
    def seed(camera: CameraProcess) -> Path:
        return camera.virtual_folder / "DCIM" / "100TEST" / "seed.jpg"


@pytest.fixture
def virtual(tmp_path):
    cameras = VirtualCameras(tmp_path)
    yield cameras
    close_cameras(cameras.made)


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """The fake library, in this process and in those that it starts, with one body at a port."""
    spec = importlib.util.spec_from_file_location("gphoto2", HERE / "fake_gphoto2.py")
    library = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(library)
    desk = tmp_path / "bus"
    desk.mkdir()
    (desk / "gphoto2.py").symlink_to(HERE / "fake_gphoto2.py")
    monkeypatch.setenv("FAKE_GPHOTO2", str(desk))
    monkeypatch.setenv("PYTHONPATH", str(desk))
    monkeypatch.delenv("VCAMERADIR", raising=False)
    monkeypatch.setitem(sys.modules, "gphoto2", library)
    library.make_body("6001")
    library.plug({"usb:001,004": "6001"})
    return library


@pytest.fixture
def processes():
    """Whatever is appended is closed at the end."""
    made: list[CameraProcess] = []
    yield made
    close_cameras(made)


@pytest.fixture
def gone():
    """Waits until a process has ended; fails when it does not."""

    def wait(pid: int, seconds: float = 5.0) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            try:
                if " Z " in Path(f"/proc/{pid}/stat").read_text():
                    return
            except FileNotFoundError:
                return
            time.sleep(0.01)
        raise AssertionError(f"process {pid} is still there")

    return wait
