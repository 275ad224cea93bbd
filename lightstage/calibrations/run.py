"""Calibration shots pose by pose: requested, taken as a session, checked, kept or retaken."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

from lightstage.calibrations.config import CalibrationConfig
from lightstage.calibrations.fingerprint import devices
from lightstage.calibrations.folder import new_shots, newest_unfinished, shots_id
from lightstage.calibrations.kinds import Kind
from lightstage.calibrations.pose import PoseLook, look_at_pose
from lightstage.calibrations.reasons import joined
from lightstage.calibrations.stale import changes
from lightstage.cameras.camera import Summary
from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.errors import CaptureError
from lightstage.findings import Finding
from lightstage.formats.calibration_shots import MANIFEST, CalibrationFile, Pose, Shots
from lightstage.formats.files import sha256_file
from lightstage.leds.controller import Hello
from lightstage.patterns import Drive
from lightstage.rig import Rig, rig_sha256, save_rig

Verdict = Literal["keep", "again", "stop"]


class PoseTaker(Protocol):
    """Takes one pose as a session folder, by the same capture as a face."""

    def __call__(self, root: Path, patterns: Sequence[str], drive: Drive) -> None:
        """Take all patterns into `root`, or resume what is in it; whole when it returns.

        Raises:
            LightstageError: it could not be finished; what was taken is kept in `root`.
        """


class Assistant(Protocol):
    """Who puts the target before the cameras."""

    def ready(self, number: int, count: int, question: str) -> bool:
        """Ask for pose `number` of `count` and wait until it is held; False: stop here."""

    def judge(self, number: int, findings: Sequence[Finding], left: int) -> Verdict:
        """What to do with a pose that does not show what it must, `left` more takes at most."""


@dataclasses.dataclass(frozen=True)
class CalibrationReport:
    """What was done.

    Attributes:
        shots: the folder.
        poses: taken in all.
        now: of these, taken now.
        again: poses that were taken again.
        warnings: what was amiss and accepted.
    """

    shots: Shots
    poses: int
    now: int
    again: int
    warnings: int


def begin_shots(
    kind: Kind,
    lab: Path,
    rig: Rig,
    summaries: Mapping[str, Summary],
    leds: Hello,
    config: CalibrationConfig,
    now: datetime.datetime,
    poses: int | None = None,
    every_light: bool = False,
) -> Shots:
    """Make the folder of new shots, with its plan.

    Args:
        kind: which.
        lab: the lab's folder.
        rig: saved beside.
        summaries: by camera id.
        leds: the LED device.
        config: how many poses, how long they hold.
        now: with its zone.
        poses: in place of the kind's own number.
        every_light: see Kind.shown.
    """
    created = now.astimezone(datetime.UTC)
    expires = created + datetime.timedelta(days=getattr(config.days, kind.name))
    sha256 = rig_sha256(rig)
    value: dict[str, Any] = {
        "id": shots_id(kind.name, created.isoformat(), sha256),
        "kind": kind.name,
        "created_utc": created.isoformat(timespec="milliseconds"),
        "expires_utc": expires.isoformat(timespec="milliseconds"),
        "rig_sha256": sha256,
        "devices": devices(summaries, leds),
        "patterns": list(kind.shown(rig, every_light)),
        "poses_wanted": poses or kind.poses(rig, config),
        "target": dataclasses.asdict(config.board) if kind.name == "charuco" else {},
    }
    shots = new_shots(lab, CalibrationFile.model_validate(value))
    save_rig(rig, shots.root / "rig.json")
    return shots


def resume_shots(
    kind: Kind, lab: Path, rig: Rig, summaries: Mapping[str, Summary], leds: Hello
) -> Shots:
    """The newest unfinished shots of a kind, to be resumed.

    Raises:
        FormatError: there are none.
        CaptureError: the stage is another than when they were begun.
    """
    shots = newest_unfinished(lab, kind.name)
    other = changes(shots, rig, summaries, leds)
    if other:
        raise CaptureError(
            shots.root,
            found="; ".join(found for _, found, _ in other),
            expected="; ".join(expected for _, _, expected in other),
            hint="Begin new shots: leave out --resume.",
        )
    return shots


def take_poses(
    kind: Kind,
    shots: Shots,
    rig: Rig,
    take: PoseTaker,
    assistant: Assistant,
    config: CalibrationConfig,
    progress: ProgressCallback = quiet,
) -> CalibrationReport:
    """Take the poses that are missing, and finish.

    Args:
        kind: which.
        shots: begun, or resumed.
        rig: the stage.
        take: the capture.
        assistant: asked before each pose, and about poses that are not usable.
        config: limits.
        progress: of poses.

    Raises:
        CaptureError: stopped before the end, or a pose was not usable in `takes_per_pose` takes;
            what was taken is kept, and can be resumed.
        LightstageError: from the capture of a pose.
    """
    again = now = 0
    count = shots.file.poses_wanted
    done = {pose.index for pose in shots.file.poses}
    progress(len(done), count)
    for index in range(count):
        if index in done:
            continue
        failed: list[Sequence[Finding]] = []
        while True:
            if not assistant.ready(index + 1, count, kind.instruction(rig, index)):
                raise _stopped(shots, index, failed)
            folder = _folder(shots, index)
            take(shots.root / folder, shots.file.patterns, kind.drive)
            look = look_at_pose(shots.root / folder, kind, index, config)
            if look.is_usable:
                break
            failed.append(look.findings)
            left = config.takes_per_pose - len(failed)
            verdict = assistant.judge(index + 1, look.findings, left)
            if verdict == "keep":
                break
            if verdict == "stop" or left <= 0:
                raise _stopped(shots, index, failed)
            again += 1
        _keep(shots, kind, rig, index, folder, look)
        now += 1
        progress(len(shots.file.poses), count)
    finished = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
    shots.file = shots.file.model_copy(update={"finished_utc": finished})
    shots.save()
    warnings = sum(len(pose.accepted) for pose in shots.file.poses)
    return CalibrationReport(shots, len(shots.file.poses), now, again, warnings)


def _folder(shots: Shots, index: int) -> str:
    """The folder of a pose's next session, noted before it is made; an unfinished one resumes."""
    takes = dict(shots.file.takes)
    number = takes.get(str(index), 0)
    if number and not (shots.root / _name(index, number) / "session.json").exists():
        return _name(index, number)
    takes[str(index)] = number + 1
    shots.file = shots.file.model_copy(update={"takes": takes})
    shots.save()
    return _name(index, number + 1)


def _name(index: int, take: int) -> str:
    return f"pose-{index + 1:02d}" + (f".take{take}" if take > 1 else "")


def _keep(shots: Shots, kind: Kind, rig: Rig, index: int, folder: str, look: PoseLook) -> None:
    manifest = shots.root / folder / MANIFEST
    pose = Pose(
        index=index,
        folder=folder,
        faces=kind.faced(rig, index),
        session_sha256=sha256_file(shots.root / folder / "session.json"),
        manifest_sha256=sha256_file(manifest) if manifest.is_file() else None,
        figures=look.figures,
        accepted=[str(finding) for finding in look.findings],
    )
    poses = sorted([*shots.file.poses, pose], key=lambda each: each.index)
    shots.file = shots.file.model_copy(update={"poses": poses})
    shots.save()


def _stopped(shots: Shots, index: int, failed: Sequence[Sequence[Finding]]) -> CaptureError:
    """Why no more is taken of a pose: what was amiss in each take, and what to change."""
    done, count = len(shots.file.poses), shots.file.poses_wanted
    found, expected = f"stopped after {done} of {counted(count, 'pose')}", "all poses"
    if not failed:
        return CaptureError(shots.root, found=found, expected=expected)
    reasons, wanted, hints = joined(failed)
    takes = counted(len(failed), "take")
    return CaptureError(
        shots.root,
        found=f"{found}: pose {index + 1} was not usable in {takes}: {reasons}",
        expected=wanted,
        hint=hints,
    )
