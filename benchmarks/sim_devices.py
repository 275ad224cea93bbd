"""What becomes of a capture under each fault: whole, refused, or wrong without a word?

Every fault that a story can tell happens to small captures, at a random moment each time. A
capture that ends well is compared, byte for byte, with what its cameras saw under the light that
its session says; `lightstage check` then says whether it would have found what differs.
"""

from __future__ import annotations

import collections
import dataclasses
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.record import record
from lightstage.cameras.binding import close_cameras
from lightstage.cameras.process import CameraProcess
from lightstage.capture import CaptureConfig, capture, connect
from lightstage.checks import check_session
from lightstage.errors import LightstageError
from lightstage.formats.session import load_session
from lightstage.leds.opening import open_leds
from lightstage.rig import Rig, default_rig
from lightstage.safety import SafetyConfig
from lightstage.sequence import plan_shots
from lightstage.session import SessionWriter
from sim.camera.dng import Exif, dng_bytes
from sim.camera.optics import own_rng
from sim.camera.sensor import SensorConfig, make_sensor
from sim.devices.fault_names import LEDS, NAMES
from sim.devices.faults import Fault, FaultLog, Story
from sim.devices.led_device import LedDevice
from sim.devices.simulated_camera import DRIVER, SimulatedCameras

CAPTURES = 6
PATTERNS = ("full", "x+", "x-", "full@parallel", "full@cross")
WIDTH, HEIGHT = 32, 48
LAST_PACKET = 2 + 2 * len(PATTERNS)
"""HELLO?, DARK, then SET and STATE? of each shot; at the last DARK no photograph is taken."""
CONFIG = CaptureConfig(
    camera_deadline_s=2.0,
    trigger_lead_s=0.0,
    safety=SafetyConfig(light_interval_s=0.0),
)
QUIET = "no fault"


def small_rig() -> Rig:
    """The stage with three of its cameras, at a thousandth of their pixels."""
    rig = default_rig()
    cameras = [
        dataclasses.replace(camera, width_px=WIDTH, height_px=HEIGHT) for camera in rig.cameras[:3]
    ]
    return Rig(rig.lights, tuple(cameras))


def seen(rig: Rig, levels: np.ndarray, number: int) -> bytes:
    """A grey card seen by a camera: the sum of the lights, more from its side; its own noise."""
    weights = 1.0 + 0.3 * np.cos(np.arange(len(levels)) + number)
    light = np.full((HEIGHT, WIDTH, 3), 0.6 * float(levels @ weights) / len(levels))
    state = np.round(levels * 65535).astype("<u2").tobytes()
    camera = rig.cameras[number]
    sensor = make_sensor(SensorConfig(), np.ones(3), own_rng(0, camera.id, b"sensor"))
    counts = sensor.expose(light, own_rng(0, camera.id, state))
    return dng_bytes(counts, sensor, Exif(camera.model, camera.serial, 16.0, 60.0))


def one_capture(rig: Rig, desk: Path, faults: Sequence[Fault], seed: int) -> tuple[str, bool]:
    """How a capture under a story ends, and whether a fault happened in it."""
    story, log = Story(faults, seed), FaultLog(desk / "faults.jsonl")
    bodies = SimulatedCameras(desk, rig, story, log)

    def show(levels: np.ndarray) -> None:
        for number, camera in enumerate(rig.cameras):
            bodies.put(camera.id, seen(rig, levels, number))

    banks = [light.bank for light in rig.lights]
    root = desk / "session"
    cameras = [
        CameraProcess(c.id, str(bodies.folder(c.id)), None, CONFIG.camera_deadline_s, DRIVER)
        for c in rig.cameras
    ]
    try:
        with (
            LedDevice(len(banks), show, 1, story, log, banks) as device,
            open_leds(device.url(0.5, 4), len(banks)) as lights,
        ):
            connect(rig, lights, cameras, [])
            writer = SessionWriter(root, rig, PATTERNS, "card", "neutral", {})
            try:
                capture(plan_shots(PATTERNS, rig), lights, cameras, writer, CONFIG)
            finally:
                writer.close()
    except LightstageError:
        return "refused", log.path is not None and log.path.exists()
    finally:
        close_cameras(cameras)
    happened = log.path is not None and log.path.exists()
    session = load_session(root)
    numbers = {camera.id: number for number, camera in enumerate(rig.cameras)}
    wrong = any(
        session.frame_path(frame).read_bytes()
        != seen(rig, session.levels(frame.pattern), numbers[frame.camera])
        for frame in session.file.frames
    )
    if not wrong:
        return "whole", happened
    try:
        check_session(root)
    except LightstageError:
        return "found", happened
    return "unfound", happened


def faults_of(name: str, rig: Rig, rng: np.random.Generator) -> list[Fault]:
    """One fault at a random moment, on a random camera, in a random direction."""
    if name == QUIET:
        return []
    known = NAMES[name]
    last = {"packet": LAST_PACKET, "open": 1, "shot": len(PATTERNS)}[known.counted]
    if name == "duplicate-serial":
        last = 1  # a camera is asked for its serial number when it is opened
    fields: dict[str, object] = {"at": int(rng.integers(1, last + 1))}
    if known.device != LEDS:
        fields["camera"] = rig.cameras[int(rng.integers(len(rig.cameras)))].id
    if "way" in known.fields:
        fields["way"] = str(rng.choice(["request", "answer"]))
    if "lights" in known.fields:
        fields["lights"] = [int(light) for light in rng.choice(len(rig.lights), 28, replace=False)]
    return [Fault(name, **fields)]


def main() -> None:
    rig = small_rig()
    rng = np.random.default_rng(1)
    rows = []
    with tempfile.TemporaryDirectory() as name_of_root:
        for name in (QUIET, *NAMES):
            endings: collections.Counter[str] = collections.Counter()
            seconds, happened = [], 0
            for number in range(CAPTURES):
                desk = Path(name_of_root) / f"{name}-{number}"
                desk.mkdir()
                begun = time.perf_counter()
                ending, did = one_capture(rig, desk, faults_of(name, rig, rng), number)
                seconds.append(time.perf_counter() - begun)
                endings[ending] += 1
                happened += did
            kinds = [endings[kind] for kind in ("whole", "refused", "found", "unfound")]
            rows.append((name, happened, *kinds, f"{statistics.median(seconds):.2f}"))
    record(
        "Faults of simulated devices",
        (
            *("fault", "captures with it", "whole", "refused and said"),
            *("wrong, found by check", "wrong, not found", "median seconds"),
        ),
        rows,
        f"{CAPTURES} captures of {', '.join(PATTERNS)} for each fault, {len(rig.lights)} lights, "
        f"{len(rig.cameras)} cameras of {WIDTH} x {HEIGHT} pixels in processes of their own; the "
        "fault at a random packet or shot, 28 lights where it is of lights. Whole: every byte is "
        "what the camera saw under the recorded light. Captures in which it did not happen "
        "(a fault beyond the last packet, a stale picture without one before it) end whole.",
    )


if __name__ == "__main__":
    main()
