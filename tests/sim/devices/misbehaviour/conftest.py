"""A small stage to which a story happens: LED device on a pty, simulated cameras, real driver."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lightstage.cameras.binding import close_cameras
from lightstage.cameras.process import CameraProcess
from lightstage.capture import CaptureConfig, capture, connect
from lightstage.errors import LightstageError
from lightstage.formats.session import load_session
from lightstage.leds.opening import open_leds
from lightstage.rig import Camera, Light, Rig, look_at
from lightstage.safety import SafetyConfig
from lightstage.sequence import plan_shots
from lightstage.session import SessionWriter, read_journal
from sim.devices.faults import Fault, FaultLog, Story, read_fault_log
from sim.devices.led_device import LedDevice
from sim.devices.simulated_camera import DRIVER, SimulatedCamera, SimulatedCameras

WIDTH, HEIGHT, BLACK, WHITE = 32, 48, 512, 16383
FAST = CaptureConfig(trigger_lead_s=0.0, safety=SafetyConfig(light_interval_s=0.0))
SEQUENCE = ("full", "x+", "x-")


def make_rig(cameras: int = 3) -> Rig:
    """Eight lights at a cube's corners, banks interleaved; three small cameras."""
    corners = [(x, y, z) for x in (-700.0, 700.0) for y in (-700.0, 700.0) for z in (-700.0, 700.0)]
    lights = tuple(
        Light(i, f"corner{i}", place, "horizontal" if i % 2 else "vertical")
        for i, place in enumerate(corners)
    )
    angles = np.radians(20.0 * np.arange(cameras) - 20.0)
    return Rig(
        lights,
        tuple(
            Camera(
                f"cam{i}", f"60{i}", "Nikon DSC D750", WIDTH, HEIGHT, 140.0, 140.0, 16.0, 24.0,
                (0.0, 0.0, 0.0, 0.0, 0.0),
                look_at(1100 * np.array([np.sin(angle), 0, np.cos(angle)]), np.zeros(3)),
            )
            for i, angle in enumerate(angles)
        ),
    )  # fmt: skip


def make_dng(levels: np.ndarray, camera: int) -> bytes:
    """What a camera sees: brighter with more light from its side, with noise of this state."""
    weights = 1.0 + 0.3 * np.cos(np.arange(len(levels)) + camera)
    state = hashlib.sha256(levels.tobytes() + bytes([camera])).digest()
    rng = np.random.default_rng(np.frombuffer(state, "<u4").tolist())
    counts = BLACK + 4000 * float(levels @ weights) / 8 + rng.integers(0, 8, (HEIGHT, WIDTH))
    tags = [
        (50706, 1, 4, b"\x01\x04\x00\x00", True),
        (50708, 2, 0, "Test camera", True),
        (33421, 3, 2, (2, 2), True),
        (33422, 1, 4, b"\x00\x01\x01\x02", True),
        (50714, 3, 1, BLACK, True),
        (50717, 3, 1, WHITE, True),
        (50721, 10, 9, [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1], True),
        (50778, 3, 1, 21, True),
    ]
    file = io.BytesIO()
    tifffile.imwrite(
        file, counts.astype(np.uint16), photometric=32803, extratags=tags, metadata=None,
        software=None,
    )  # fmt: skip
    return file.getvalue()


@dataclasses.dataclass
class Ending:
    """How a capture ended.

    Attributes:
        said: what the operator was told; empty when all went well.
        root: the session's folder.
        dark: whether the lights were dark when the capture had ended.
        happened: names of the faults, in order.
    """

    said: str
    root: Path
    dark: bool
    happened: list[str]

    @property
    def fine(self) -> bool:
        """Whether there is a finished session."""
        return not self.said and (self.root / "session.json").is_file()

    def kept(self) -> list[str]:
        """Photographs on the disk, as PATTERN/CAMERA."""
        files = self.root.glob("frames/*/*.dng")
        return sorted(f"{path.parent.name}/{path.stem}" for path in files)

    def shots(self) -> list[str]:
        """Patterns whose light lasted through all their photographs."""
        events = read_journal(self.root / "journal.jsonl")
        return [event["pattern"] for event in events if event["event"] == "shot"]


class Stage:
    """Runs `lightstage.capture` while a story happens to its devices."""

    def __init__(self, root: Path, rig: Rig, patterns: tuple[str, ...] = SEQUENCE) -> None:
        self.root = root
        self.rig = rig
        self.patterns = patterns
        self.captures = 0

    def capture(
        self,
        *faults: Fault,
        seed: int = 0,
        timeout_s: float = 0.2,
        attempts: int = 3,
        settings: dict[str, dict[str, Any]] | None = None,
        camera_deadline_s: float | None = None,
    ) -> Ending:
        """Photograph the sequence while this happens.

        With a deadline the cameras are processes of their own, else they are in this one.
        """
        self.captures += 1
        desk = self.root / f"desk{self.captures}"
        desk.mkdir()
        story, log = Story(faults, seed), FaultLog(desk / "faults.jsonl")
        bodies = SimulatedCameras(desk, self.rig, story, log, settings)
        root = desk / "session"
        banks = [light.bank for light in self.rig.lights]

        def show(levels: np.ndarray) -> None:
            for number, camera in enumerate(self.rig.cameras):
                bodies.put(camera.id, make_dng(levels, number))

        said, writer, cameras = "", None, []
        with LedDevice(len(self.rig.lights), show, 1, story, log, banks) as device:
            try:
                with open_leds(device.url(timeout_s, attempts), len(banks)) as lights:
                    ports = {c.id: str(bodies.folder(c.id)) for c in self.rig.cameras}
                    cameras = [Named(name, port) for name, port in ports.items()]
                    if camera_deadline_s is not None:
                        cameras = [
                            CameraProcess(name, port, None, camera_deadline_s, DRIVER)
                            for name, port in ports.items()
                        ]
                    connect(self.rig, lights, cameras, [])
                    shots = plan_shots(self.patterns, self.rig)
                    writer = SessionWriter(
                        root, self.rig, [shot.pattern for shot in shots], "p1", "neutral", {}
                    )
                    capture(shots, lights, cameras, writer, FAST)
            except LightstageError as error:
                said = str(error)
            finally:
                close_cameras(cameras)
                if writer is not None:
                    writer.close()
            until = time.monotonic() + 5
            while device.connected.is_set() and time.monotonic() < until:
                time.sleep(0.001)
            dark = device.dark
        assert device.failure is None
        happened = [told.name for told in read_fault_log(desk / "faults.jsonl")]
        return Ending(said, root, dark, happened)

    def mislabelled(self, ending: Ending) -> list[str]:
        """Frames of a finished session that are not what their camera saw under their light."""
        session = load_session(ending.root)
        return [
            frame.path
            for frame in session.file.frames
            if session.frame_path(frame).read_bytes()
            != make_dng(session.levels(frame.pattern), int(frame.camera[-1]))
        ]


class Named(SimulatedCamera):
    """A simulated camera in this process, under the rig's name (CameraDevice)."""

    def __init__(self, camera_id: str, port: str) -> None:
        super().__init__(port)
        self.id = camera_id


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path, make_rig())


@pytest.fixture
def rig() -> Rig:
    return make_rig()


@pytest.fixture
def seen() -> Callable[[np.ndarray, int], bytes]:
    """make_dng, for tests that cannot import this file."""
    return make_dng
