"""Captures under each fault: whole, refused, or wrong without a word.

Every fault that a story can have happens to small captures, at a random moment each time. The
photographs of a capture that ends well show who took them under which light (by their pixels);
then it is tested whether `lightstage check` would have found what differs.
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
from lightstage.cameras.binding import read_cameras_file
from lightstage.cameras.process import Deadlines
from lightstage.capture import CaptureConfig, Order, capture_session, open_stage
from lightstage.checks import check_session
from lightstage.errors import LightstageError
from lightstage.operator import Unattended
from lightstage.rig import Rig, default_rig
from lightstage.safety import SafetyConfig
from lightstage.sequence import plan_shots
from sim.devices.coded_stage import CodedStage
from sim.devices.fault_names import LEDS, NAMES, OF_ICL
from sim.devices.faults import Fault, Story, read_fault_log

CAPTURES = 6
PATTERNS = ("full", "x+", "x-", "y+", "y-")
WIDTH, HEIGHT = 48, 64
LAST_PACKET = 2 + 2 * len(PATTERNS)
"""HELLO?, DARK, then SET and STATE? of each shot; at the last DARK no photograph is taken."""
CONFIG = CaptureConfig(
    deadlines=Deadlines.all(5.0),
    trigger_lead_s=0.0,
    safety=SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0),
)
QUIET = "no fault"


def small_rig() -> Rig:
    """The stage with three of its cameras, at a thousandth of their pixels."""
    rig = default_rig()
    cameras = [
        dataclasses.replace(camera, width_px=WIDTH, height_px=HEIGHT) for camera in rig.cameras[:3]
    ]
    return Rig(rig.lights, tuple(cameras))


def one_capture(rig: Rig, desk: Path, faults: Sequence[Fault], seed: int) -> tuple[str, bool]:
    """Run a capture under a story; how it ends, and whether a fault happened in it."""
    root = desk / "session"
    with CodedStage(desk / "stage", rig, Story(faults, seed), seed) as coded:
        cameras = read_cameras_file(coded.cameras_path)
        try:
            with open_stage(rig, coded.device.url(0.5, 4), cameras, CONFIG) as stage:
                order = Order(root, plan_shots(PATTERNS, rig, CONFIG.drive))
                capture_session(stage, order, CONFIG, Unattended(CONFIG.operator))
        except LightstageError:
            return "refused", bool(read_fault_log(desk / "stage" / "faults.jsonl"))
        happened = bool(read_fault_log(desk / "stage" / "faults.jsonl"))
        if coded.labels(root).right == len(PATTERNS) * len(rig.cameras):
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
        for name in (QUIET, *(each for each in NAMES if each not in OF_ICL)):
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
        "fault at a random packet or shot, 28 lights where it is of lights. Whole: every "
        "photograph is its camera's, under the recorded light. Captures in which it did not happen "
        "(a fault beyond the last packet, a stale picture without one before it) end whole.",
    )


if __name__ == "__main__":
    main()
