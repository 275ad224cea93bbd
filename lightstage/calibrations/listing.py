"""A lab's calibration shots in plain words: kinds, age, and how long they are still valid."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Sequence
from pathlib import Path

from lightstage.calibrations.config import CalibrationConfig
from lightstage.calibrations.folder import lab_shots
from lightstage.calibrations.kinds import KINDS
from lightstage.calibrations.stale import duration
from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.calibration_shots import Shots


@dataclasses.dataclass(frozen=True)
class Entry:
    """One kind of a lab, or one folder of it.

    Attributes:
        kind: of KINDS.
        folder: in the lab; empty where there is none.
        state: ``holds``, ``expired``, ``unfinished``, ``replaced`` (by newer ones), ``future``,
            ``missing``.
        says: the same with times, in plain words.
        rig: SHA-256 of the rig.json that it was taken with; empty where there is none.
    """

    kind: str
    folder: str
    state: str
    says: str
    rig: str = ""


def list_lab(
    lab: Path, now: datetime.datetime, config: CalibrationConfig
) -> tuple[list[Entry], list[str]]:
    """All shots of a lab by kind, newest first, and what of it cannot be read.

    Whether rig, cameras and LEDs are still the same is not known without them: a capture checks it.

    Raises:
        FormatError: no such folder, or a session's.
    """
    if (lab / "journal.jsonl").exists() or (lab / "session.json").exists():
        raise FormatError(
            lab,
            found="a session",
            expected="a lab's folder of calibration shots",
            hint="Give the folder that `lightstage calibrate` was given with --out.",
        )
    shots, problems = lab_shots(lab)
    entries: list[Entry] = []
    for kind in KINDS:
        own = [each for each in reversed(shots) if each.file.kind == kind]
        replaced = False
        for each in own:
            entries.append(_entry(each, now, config, replaced))
            replaced = replaced or each.file.finished_utc is not None
        if not own:
            wanted = ", wanted by every session" if kind in config.wanted else ""
            entries.append(Entry(kind, "", "missing", f"none yet{wanted}"))
    unknown = [each for each in shots if each.file.kind not in KINDS]
    problems_in_words = [
        f"{each.root.name}: an unknown kind, {each.file.kind!r}" for each in unknown
    ]
    return entries, problems_in_words + [str(problem) for problem in problems]


def _entry(
    shots: Shots, now: datetime.datetime, config: CalibrationConfig, replaced: bool
) -> Entry:
    file = shots.file
    age = file.age_days(now)
    left = (file.expires - now).total_seconds() / 86400
    if age < -config.clock_slack_s / 86400:
        state = "future"
        text = f"made {duration(-age)} after now: is the computer's clock right?"
    elif file.finished_utc is None:
        state = "unfinished"
        text = (
            f"{len(file.poses)} of {counted(file.poses_wanted, 'pose')}, begun "
            f"{duration(age)} ago; calibrate {file.kind} with --resume and its other options "
            "resumes them"
        )
    elif replaced:
        state, text = "replaced", f"{duration(age)} old, newer ones count"
    elif left <= 0:
        state, text = "expired", f"{duration(age)} old, expired {duration(-left)} ago"
    else:
        state, text = "holds", f"{duration(age)} old, holds {duration(left)} more"
    accepted = sum(len(pose.accepted) for pose in file.poses)
    if accepted:
        text += f" ({counted(accepted, 'fault')} accepted by the operator)"
    return Entry(file.kind, shots.root.name, state, text, file.rig_sha256)


def rigs_of(entries: Sequence[Entry]) -> str:
    """Which of the shots that hold were taken with which rig; empty where it is one."""
    kinds: dict[str, list[str]] = {}
    for entry in entries:
        if entry.state == "holds":
            kinds.setdefault(entry.rig, []).append(entry.kind)
    if len(kinds) < 2:
        return ""
    groups = "; ".join(f"{', '.join(own)} with {rig[:8]}" for rig, own in kinds.items())
    return (
        f"taken with {len(kinds)} files rig.json ({groups}): a session takes those of its own rig, "
        "and of the one that its cameras were measured with"
    )
