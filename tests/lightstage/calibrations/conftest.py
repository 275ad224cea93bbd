"""A stage of three cameras with small pictures, and sessions of targets without any device."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from lightstage.cameras.camera import Summary
from lightstage.errors import CaptureError
from lightstage.formats.files import sha256_file, write_bytes, write_json
from lightstage.formats.session import Driven, Frame, SessionFile, save_session
from lightstage.leds.controller import Hello
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig, default_rig, save_rig
from sim.devices.target_photographer import TargetPhotographer

SCALE = 0.08
LEDS = Hello(boot_id=1, light_count=168, firmware="leds 1.0")
NOW = datetime.datetime(2026, 3, 1, 12, 0, tzinfo=datetime.UTC)


@pytest.fixture(scope="session")
def small_stage() -> Rig:
    """Three cameras of the default rig with small pictures."""
    rig = default_rig().scaled(SCALE)
    return Rig(rig.lights, rig.cameras[:3])


def summaries_by(rig: Rig) -> dict[str, Summary]:
    """What its cameras report."""
    return {
        camera.id: Summary(
            serial=camera.serial,
            model=camera.model,
            iso="100",
            shutter="1/60",
            aperture="f/8",
            focus="Manual",
        )
        for camera in rig.cameras
    }


@dataclasses.dataclass
class Taker:
    """Takes poses from a photographer straight into session folders.

    Attributes:
        photographer: what lies before the cameras.
        fail: folders' names at which the capture fails, once each.
        taken: folders' names, in order.
        drives: how each was to be driven.
    """

    photographer: TargetPhotographer
    fail: set[str] = dataclasses.field(default_factory=set)
    taken: list[str] = dataclasses.field(default_factory=list)
    drives: list[str] = dataclasses.field(default_factory=list)

    def __call__(self, root: Path, patterns: Sequence[str], drive: str) -> None:
        self.taken.append(root.name)
        self.drives.append(drive)
        rig = self.photographer.rig
        save_rig(rig, root / "rig.json")
        (root / "journal.jsonl").touch()
        if root.name in self.fail:
            self.fail.remove(root.name)
            raise CaptureError(root, found="a cable that was pulled")
        frames, driven = [], {}
        for pattern in patterns:
            levels = pattern_levels(pattern, rig)
            driven[pattern] = Driven(levels=levels.tolist())
            for camera in rig.cameras:
                path = f"frames/{pattern}/{camera.id}.dng"
                write_bytes(root / path, self.photographer.photograph(camera, levels))
                digest = sha256_file(root / path)
                frames.append(
                    Frame(
                        pattern=pattern, camera=camera.id, path=path, sha256=digest, encoding="raw"
                    )
                )
        save_session(
            root,
            SessionFile(
                id="t",
                created_utc=NOW.isoformat(),
                subject="target",
                expression="none",
                sequence=list(patterns),
                frames=frames,
                patterns=driven,
            ),
        )
        write_json(root / "manifest.json", {"schema": "lightstage.manifest/1"})


@dataclasses.dataclass
class Holder:
    """Holds each pose as it is asked for, and answers as it was ordered to.

    Attributes:
        photographer: whose pose it sets.
        verdicts: answers about poses that are not usable, in order.
        stop_at: the pose before which it stops, from 1.
        asked: what it was asked to do.
        findings: what it was shown as amiss.
        left: how many takes more, as it was shown each time.
    """

    photographer: TargetPhotographer
    verdicts: list[str] = dataclasses.field(default_factory=list)
    stop_at: int | None = None
    asked: list[str] = dataclasses.field(default_factory=list)
    findings: list[object] = dataclasses.field(default_factory=list)
    left: list[int] = dataclasses.field(default_factory=list)
    mend: Callable[[], None] = lambda: None

    def ready(self, number: int, count: int, asked: str) -> bool:
        assert number <= count
        self.asked.append(asked)
        self.photographer.pose = number - 1
        return number != self.stop_at

    def judge(self, number: int, findings: Sequence[object], left: int) -> str:
        assert all(f"pose {number}" in str(finding) for finding in findings)
        self.findings += findings
        self.left.append(left)
        self.mend()
        return self.verdicts.pop(0)


@pytest.fixture(scope="session")
def bench():
    """LEDS, NOW, summaries_by, Taker and Holder, for tests that cannot import this file."""

    class Bench:
        leds, now = LEDS, NOW
        summaries = staticmethod(summaries_by)
        taker, holder = Taker, Holder
        dark = np.zeros(168)

    return Bench
