"""Calibration photographs: a lab's newest finished shots, or one session of targets.

A lab holds LAB/KIND-UTC/calibration.json (lightstage.calibration-shots/1) and a session folder for
each pose. A session of targets holds all kinds, its patterns named KIND-NN.
"""

from __future__ import annotations

import dataclasses
import datetime
import re
from pathlib import Path
from typing import Any

from lightstage.errors import FormatError, LightstageError, one_error
from lightstage.formats.calibration_shots import NAME, Shots, read_shots
from lightstage.formats.files import read_json, sha256_file
from lightstage.formats.session import Session, load_session

RESULT = "lightstage.calibration/1"
"""Schema of the calibration.json that `calibrate` writes; shots have another."""

KINDS = ("charuco", "mirror", "grey", "chart", "dark", "flat")


@dataclasses.dataclass(frozen=True)
class Pose:
    """One thing, photographed by all cameras as it was held once.

    Attributes:
        kind: of KINDS.
        session: that holds the photographs.
        patterns: of the session that show it.
        faces: the camera that it was held toward; None: all, or not known.
    """

    kind: str
    session: Session
    patterns: tuple[str, ...]
    faces: str | None

    @property
    def where(self) -> str:
        """To name in errors."""
        name = self.session.root.name
        if (self.session.root.parent / NAME).is_file():
            name = f"{self.session.root.parent.name}/{name}"
        return f"{name}, {self.patterns[0]}"

    def photograph(self, camera: str, pattern: str | None = None) -> Path:
        """The file of a camera's photograph; of the first pattern where none is named.

        Raises:
            FormatError: there is none.
        """
        wanted = self.patterns[0] if pattern is None else pattern
        return self.session.frame_path(self.session.frame(wanted, camera))


@dataclasses.dataclass(frozen=True)
class Source:
    """Calibration photographs by kind.

    Attributes:
        root: the lab's folder, or the session's.
        poses: kind to its poses, in the order they were taken; kinds that are missing are absent.
        facts: kind to what its shots are (folder, id, created_utc, expires_utc, sha256; target, the
            board's measures, where the shots have them).
        warnings: sentences for the user.
    """

    root: Path
    poses: dict[str, list[Pose]]
    facts: dict[str, dict[str, Any]]
    warnings: list[str]

    def cameras(self) -> list[str]:
        """Ids of all cameras that took photographs, in the rigs' order."""
        found: dict[str, None] = {}
        for poses in self.poses.values():
            for pose in poses:
                found.update(dict.fromkeys(pose.session.camera_ids()))
        return list(found)


def _is_result(path: Path) -> bool:
    """Whether a calibration.json is the result of a calibration, whose folder may be in the lab."""
    try:
        value = read_json(path)
    except FormatError:
        return False
    return isinstance(value, dict) and value.get("schema") == RESULT


def read_source(root: Path, now: datetime.datetime | None = None) -> Source:
    """Find the photographs that a calibration is made from.

    Args:
        root: a lab's folder (of each kind the newest finished shots count), or a session of
            targets as `lightstage-sim targets` writes it.
        now: by which kinds have expired; the computer's clock by default.

    Raises:
        FormatError: no such folder, nothing finished in it, or shots that were changed since, all
            in one message.
    """
    if (root / "session.json").is_file():
        return _targets(load_session(root))
    if not root.is_dir():
        raise FormatError(
            root,
            found="no such folder" if not root.exists() else "a file",
            expected="a lab's folder of calibration shots, or a session of targets",
            hint="`lightstage calibrate KIND --out LAB` makes one.",
        )
    newest: dict[str, Shots] = {}
    problems: list[LightstageError] = []
    for path in sorted(root.glob(f"*/{NAME}")):
        if _is_result(path):
            continue
        try:
            shots = read_shots(path.parent)
        except FormatError as error:
            problems.append(error)
            continue
        kind = shots.file.kind
        finished = shots.file.finished_utc is not None
        newer = kind not in newest or shots.file.created > newest[kind].file.created
        if finished and kind in KINDS and newer:
            newest[kind] = shots
    if problems:
        raise one_error(problems)
    if not newest:
        raise FormatError(
            root,
            found="no finished calibration shots",
            expected="some, each in a folder KIND-UTC",
            hint="Take them: `lightstage calibrate KIND --out LAB`.",
        )
    poses: dict[str, list[Pose]] = {}
    facts: dict[str, dict[str, Any]] = {}
    warnings = []
    now = now or datetime.datetime.now(datetime.UTC)
    for kind in (name for name in KINDS if name in newest):
        shots = newest[kind]
        try:
            poses[kind] = _poses(kind, shots)
        except LightstageError as error:
            problems.append(error)
        extra = shots.file.model_extra or {}
        facts[kind] = {
            "folder": shots.root.name,
            "id": shots.file.id,
            "created_utc": shots.file.created_utc,
            "expires_utc": shots.file.expires_utc,
            "sha256": shots.sha256,
            **({"target": extra["target"]} if extra.get("target") else {}),
        }
        if shots.file.expires < now:
            warnings.append(f"{shots.root.name} expired {shots.file.expires_utc}")
    if problems:
        raise one_error(problems)
    if len({shots.file.rig_sha256 for shots in newest.values()}) > 1:
        warnings.append("the kinds were not all photographed with one rig.json")
    return Source(root, poses, facts, warnings)


def _poses(kind: str, shots: Shots) -> list[Pose]:
    """The poses that count of one folder of shots.

    Raises:
        FormatError: none, or a pose's session is not the one that was taken.
    """
    problems = shots.changed()
    if problems:
        raise one_error(problems)
    if not shots.file.poses:
        raise FormatError(shots.root / NAME, field="poses", found="none", expected="some")
    poses = []
    for pose in shots.file.poses:
        session = load_session(shots.root / pose.folder)
        poses.append(Pose(kind, session, tuple(session.file.sequence), pose.faces))
    return poses


def _targets(session: Session) -> Source:
    """All kinds in one session, each pattern named KIND-NN."""
    poses: dict[str, list[Pose]] = {}
    for pattern in session.file.sequence:
        kind = re.match(r"[a-z]+", pattern)
        if kind is not None and kind[0] in KINDS and re.fullmatch(r"[a-z]+-\d+", pattern):
            poses.setdefault(kind[0], []).append(Pose(kind[0], session, (pattern,), None))
    if not poses:
        raise FormatError(
            session.root / "session.json",
            field="sequence",
            found=", ".join(session.file.sequence)[:80],
            expected="patterns such as chart-00, flat-00, dark-00",
            hint="Name a lab's folder, or a session of calibration targets.",
        )
    target = {
        "folder": session.root.name,
        "id": session.file.id,
        "created_utc": session.file.created_utc,
        "sha256": sha256_file(session.root / "session.json"),
    }
    return Source(session.root, poses, {kind: dict(target) for kind in poses}, [])
