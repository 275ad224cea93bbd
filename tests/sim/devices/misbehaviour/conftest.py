"""A small stage to which a story happens: LED device on a pty, simulated cameras, real capture."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightstage.cameras.binding import CamerasFile, close_cameras, try_cameras
from lightstage.cameras.camera import Summary
from lightstage.cameras.process import CameraProcess, Deadlines
from lightstage.capture import CaptureConfig, CaptureReport, Order, Stage, capture_session
from lightstage.errors import LightstageError, one_error
from lightstage.leds.opening import open_rig_leds
from lightstage.operator import OperatorConfig, Unattended
from lightstage.patterns import Drive
from lightstage.rig import Camera, Light, Rig, look_at
from lightstage.safety import SafeLights, SafetyConfig
from lightstage.sequence import plan_shots
from lightstage.session import read_journal
from sim.devices.coded_stage import CodedStage, Labels
from sim.devices.faults import Fault, Story, read_fault_log
from sim.devices.led_device import WATCHDOG_S, LitState
from sim.devices.simulated_camera import DRIVER, SimulatedCamera

WIDTH, HEIGHT = 48, 64
RETAKES = 2
FAST = CaptureConfig(
    trigger_lead_s=0.0,
    deadlines=Deadlines.all(5.0),
    safety=SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0),
    operator=OperatorConfig(retakes=RETAKES),
)
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
                f"cam{i}", f"60{i}", "Nikon DSC D750", WIDTH, HEIGHT, 140.0, 140.0, WIDTH / 2,
                HEIGHT / 2, (0.0, 0.0, 0.0, 0.0, 0.0),
                look_at(1100 * np.array([np.sin(angle), 0, np.cos(angle)]), np.zeros(3)),
            )
            for i, angle in enumerate(angles)
        ),
    )  # fmt: skip


@dataclasses.dataclass
class Ending:
    """How a capture ended.

    Attributes:
        message: the error that the operator got; empty when all went well.
        root: the session's folder.
        dark: whether the lights were dark when the capture had ended.
        happened: names of the faults, in order.
        report: of a capture that was finished.
        labels: what the photographs of a finished session say of themselves.
        shone: what shone when, as the LED device knows it.
    """

    message: str
    root: Path
    dark: bool
    happened: list[str]
    report: CaptureReport | None
    labels: Labels | None
    shone: list[LitState]

    @property
    def fine(self) -> bool:
        """Whether there is a finished session whose every photograph is what it is called."""
        return self.labels is not None and self.labels == Labels(self.labels.right)

    def kept(self) -> list[str]:
        """Photographs on the disk, as PATTERN/CAMERA, retakes too."""
        files = self.root.glob("frames/*/*.dng")
        return sorted(f"{path.parent.name}/{path.stem}" for path in files)

    def recovered(self) -> list[str]:
        """Photographs of uncertain light, as CAMERA/NAME."""
        return sorted(f"{p.parent.name}/{p.name}" for p in self.root.glob("recovered/*/*"))

    def lines(self, *events: str) -> list[dict[str, Any]]:
        """Lines of the journal of these events."""
        lines = read_journal(self.root / "journal.jsonl")
        return [line for line in lines if line["event"] in events]

    def shots(self) -> list[str]:
        """Patterns whose light lasted through all their photographs."""
        return [line["pattern"] for line in self.lines("shot")]


class SmallStage:
    """Captures with `lightstage.capture` while a story happens to its devices."""

    def __init__(self, root: Path, rig: Rig, patterns: tuple[str, ...] = SEQUENCE) -> None:
        self.root = root
        self.rig = rig
        self.patterns = patterns
        self.drive: Drive = "on-off"
        self.config = FAST
        self.watchdog_s: float | None = WATCHDOG_S
        self.captures = self.desks = 0
        self.watch: Callable[[Path, dict[str, Any]], object] = lambda _root, _line: None

    def capture(
        self,
        *faults: Fault,
        seed: int = 0,
        timeout_s: float = 0.2,
        attempts: int = 3,
        settings: dict[str, dict[str, Any]] | None = None,
        deadlines: Deadlines | None = None,
    ) -> Ending:
        """Photograph the sequence while this happens.

        With deadlines the cameras are processes of their own, else they are in this one.
        """
        with self.standing(*faults, seed=seed, settings=settings) as standing:
            return standing.capture(timeout_s=timeout_s, attempts=attempts, deadlines=deadlines)

    @contextlib.contextmanager
    def standing(
        self,
        *faults: Fault,
        seed: int = 0,
        settings: dict[str, dict[str, Any]] | None = None,
    ) -> Iterator[StandingStage]:
        """Devices that stand ready for one session after the other while this happens."""
        self.desks += 1
        desk = self.root / f"desk{self.desks}"
        story = Story(faults, seed)
        with CodedStage(desk, self.rig, story, seed, None, self.watchdog_s) as coded:
            for camera_id, own in (settings or {}).items():
                preset(coded.cameras.folder(camera_id), own)
            yield StandingStage(self, coded, desk)


class StandingStage:
    """Devices, and the people who sit down before them one after the other."""

    def __init__(self, small: SmallStage, coded: CodedStage, desk: Path) -> None:
        self.small = small
        self.coded = coded
        self.desk = desk

    def capture(
        self,
        root: Path | None = None,
        patterns: tuple[str, ...] | None = None,
        order: Order | None = None,
        timeout_s: float = 0.2,
        attempts: int = 3,
        deadlines: Deadlines | None = None,
        untold: tuple[str, ...] = (),
    ) -> Ending:
        """A session of whoever sits there now, or what is ordered of one."""
        small, coded, since = self.small, self.coded, self.coded.lights
        small.captures += 1
        root = root or small.root / f"session{small.captures}"
        order = order or Order(root, plan_shots(patterns or small.patterns, small.rig, small.drive))
        text, report, labels = "", None, None
        cameras: list[Any] = []
        try:
            with open_rig_leds(coded.device.url(timeout_s, attempts), small.rig) as leds:
                ports = {c.id: str(coded.cameras.folder(c.id)) for c in small.rig.cameras}
                cameras = [
                    Named(name, port)
                    if deadlines is None
                    else CameraProcess(name, port, None, deadlines, DRIVER)
                    for name, port in ports.items()
                ]
                with SafeLights(leds, small.config.safety, small.rig) as lights:
                    lights.dark()
                    summaries, failed = try_cameras(cameras)
                    if failed:
                        raise one_error(failed)
                    file = CamerasFile(allow_unverifiable=untold)
                    stage = Stage(small.rig, lights, tuple(cameras), summaries, file)
                    operator = Watching(small.config.operator)
                    operator.watch = functools.partial(small.watch, root)
                    report = capture_session(stage, order, small.config, operator)
                    labels = coded.labels(root, 0 if order.resume else since)
        except LightstageError as error:
            text = str(error)
        finally:
            close_cameras(cameras)
        until = time.monotonic() + 5
        while coded.device.connected.is_set() and time.monotonic() < until:
            time.sleep(0.001)
        assert coded.device.failure is None
        happened = [happenings.name for happenings in read_fault_log(self.desk / "faults.jsonl")]
        dark, shone = coded.device.dark, coded.device.states
        return Ending(text, root, dark, happened, report, labels, shone)


class Watching(Unattended):
    """Nobody is asked; a test does something to the disk at a line of the journal."""

    watch: Callable[[dict[str, Any]], object]

    def receive(self, line: Mapping[str, Any], old: bool = False) -> None:
        super().receive(line, old)
        self.watch(dict(line))


class Named(SimulatedCamera):
    """A simulated camera in this process, under the rig's name (CameraDevice)."""

    def __init__(self, camera_id: str, port: str) -> None:
        super().__init__(port)
        self.id = camera_id

    def trigger(self, at_s: float, _pattern: str = "*"):
        """As the driver does; the pattern is for the names of steps."""
        return super().trigger(at_s)

    def download(self, name: str, path: Path, _pattern: str = "*"):
        """As the driver does."""
        return super().download(name, path)

    def restart(self) -> Summary:
        """Let go and connect again, for twice as long as a story's camera is away."""
        until_s = time.monotonic() + 1.0
        while True:
            self.close()
            try:
                return self.open()
            except LightstageError:
                if time.monotonic() > until_s:
                    raise
                time.sleep(0.05)


def preset(folder: Path, settings: dict[str, Any]) -> None:
    """Turn a body's wheels before it is switched on."""
    path = folder / "camera.json"
    value = json.loads(path.read_text())
    value["settings"].update(settings)
    path.write_text(json.dumps(value))


@pytest.fixture
def stage(tmp_path: Path) -> SmallStage:
    return SmallStage(tmp_path, make_rig())


@pytest.fixture
def rig() -> Rig:
    return make_rig()


@pytest.fixture
def seen() -> Callable[[np.ndarray, int], bytes]:
    """A photograph of these levels, for a body of this test's own."""
    from tests.lightstage.conftest import make_dng

    def photograph(levels: np.ndarray, camera: int) -> bytes:
        return make_dng(512 + int(1000 * levels.mean()), seed=camera)

    return photograph
