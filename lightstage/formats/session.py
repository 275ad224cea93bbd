"""Session folder: session.json, its rig and its photographs. What was driven, shot and hashed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Strict, StringConstraints, ValidationError

from lightstage.counting import counted
from lightstage.errors import FormatError, LightstageError, PatternError, one_error
from lightstage.formats.files import read_json, sha256_file, write_json
from lightstage.formats.names import require_pseudonym
from lightstage.formats.paths import check_name, path_inside
from lightstage.formats.validation import validation_error
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig, load_rig

SCHEMA = "lightstage.session/1"


class Frame(BaseModel):
    """One photograph of a session.

    Others may add fields. A capture adds ``take`` (1, or more where it was taken again),
    ``acknowledged`` (whether the lights reported that they were lit), and ``verified`` where less
    than its hash could be compared after a crash (``size and header``).
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    pattern: str
    camera: str
    path: str
    sha256: Annotated[str, StringConstraints(to_lower=True)]
    """In small letters; some programs, such as PowerShell, write capitals."""
    encoding: Literal["raw", "linear"]


class Driven(BaseModel):
    """What was really driven for a pattern: one level in 0..1 a light, in the rig's order."""

    model_config = ConfigDict(extra="allow", frozen=True)

    levels: list[Annotated[float, Strict()]]


class Calibration(BaseModel):
    """Calibration files inside the session folder, null where there is none."""

    model_config = ConfigDict(extra="allow", frozen=True)

    colour: str | None = None
    cameras: str | None = None
    lights: str | None = None


class SessionFile(BaseModel):
    """session.json. Unknown fields are kept: others may add theirs.

    A capture adds ``consent``, the id of the record of the person's consent, where there is one,
    and ``accepted``, where the operator accepted photographs with faults: by pattern, the findings.
    """

    model_config = ConfigDict(extra="allow", frozen=True, populate_by_name=True)

    schema_: str = Field(alias="schema", default=SCHEMA)
    id: str
    created_utc: str
    subject: str
    expression: str
    sequence: list[str]
    frames: list[Frame]
    patterns: dict[str, Driven] = {}
    calibration: Calibration = Calibration()


class Session:
    """A session folder that was read and found to be well formed.

    Attributes:
        root: the folder.
        file: session.json's content.
        rig: the rig in it.
    """

    def __init__(self, root: Path, file: SessionFile, rig: Rig) -> None:
        self.root = root
        self.file = file
        self.rig = rig

    def frame(self, pattern: str, camera: str) -> Frame:
        """The photograph of a pattern by a camera; FormatError when there is none."""
        for frame in self.file.frames:
            if frame.pattern == pattern and frame.camera == camera:
                return frame
        raise FormatError(
            self.root / "session.json",
            field="frames",
            found=f"no photograph of pattern {pattern} by {camera}",
            expected="one for each pattern and camera",
            hint="Take that shot again, or import it.",
        )

    def frame_path(self, frame: Frame) -> Path:
        """The file of a photograph."""
        return self.root / frame.path

    def levels(self, pattern: str) -> np.ndarray:
        """(n,) what was driven for a pattern; where not recorded, its name at level 1."""
        driven = self.file.patterns.get(pattern)
        return pattern_levels(pattern, self.rig) if driven is None else np.array(driven.levels)

    def camera_ids(self) -> list[str]:
        """Cameras of the rig that took photographs, in the rig's order."""
        used = {frame.camera for frame in self.file.frames}
        return [camera.id for camera in self.rig.cameras if camera.id in used]


def load_session(root: Path) -> Session:
    """Read session.json and rig.json and check that they fit together (not the photographs' bytes).

    Raises:
        FormatError: every fault found, in one message.
    """
    path = root / "session.json"
    if not path.is_file():
        found = "no session.json" if root.is_dir() else "no such folder"
        if (root / "report.json").is_file():
            found = "a processed folder, or the truth of a simulated session"
        raise FormatError(
            root,
            found=found,
            expected="a session folder",
            hint="A session is what `lightstage capture`, `lightstage import` or `lightstage-sim "
            "session` wrote.",
        )
    value = read_json(path, SCHEMA)
    try:
        file = SessionFile.model_validate(value)
    except ValidationError as error:
        raise validation_error(error, path) from None
    rig = load_rig(root / "rig.json")
    session = Session(root, file, rig)
    problems = _faults(session)
    if problems:
        raise one_error(problems)
    return session


def save_session(root: Path, file: SessionFile) -> Path:
    """Write session.json atomically; returns its path."""
    return write_json(root / "session.json", file.model_dump(by_alias=True, mode="json"))


def missing_frames(session: Session) -> list[LightstageError]:
    """One error for each photograph that is named but not there, or absent from the grid."""
    problems: list[LightstageError] = []
    for pattern in session.file.sequence:
        for camera in session.rig.cameras:
            try:
                path = session.frame_path(session.frame(pattern, camera.id))
            except FormatError as error:
                problems.append(error)
                continue
            if not path.is_file():
                problems.append(
                    FormatError(
                        path,
                        found="no such file",
                        expected=f"the photograph of {pattern} by {camera.id}",
                        hint="Copy it back from the camera or take that shot again.",
                    )
                )
    return problems


def changed_frames(session: Session) -> list[LightstageError]:
    """One error for each photograph whose bytes are not those that were hashed at capture."""
    problems: list[LightstageError] = []
    for frame in session.file.frames:
        path = session.frame_path(frame)
        if not path.is_file():
            continue
        found = sha256_file(path)
        if found != frame.sha256:
            problems.append(
                FormatError(
                    path,
                    field="sha256",
                    found=f"{found[:12]}.. of {path.stat().st_size} bytes",
                    expected=f"{frame.sha256[:12]}..",
                    hint="The file changed or was cut since capture; restore it.",
                )
            )
    return problems


def _faults(session: Session) -> list[LightstageError]:
    path = session.root / "session.json"
    problems: list[LightstageError] = []
    cameras = {camera.id for camera in session.rig.cameras}
    for field in ("subject", "expression"):
        try:
            require_pseudonym(getattr(session.file, field), path, field)
        except FormatError as error:
            problems.append(error)
    seen: set[tuple[str, str]] = set()
    for index, frame in enumerate(session.file.frames):
        field = f"frames[{index}]"
        if frame.camera not in cameras:
            problems.append(
                FormatError(path, field=field, found=frame.camera, expected="a camera of rig.json")
            )
        if frame.pattern not in session.file.sequence:
            problems.append(
                FormatError(
                    path, field=field, found=frame.pattern, expected="a pattern of the sequence"
                )
            )
        try:
            path_inside(session.root, frame.path, path, f"{field}.path")
        except FormatError as error:
            problems.append(error)
        if (frame.pattern, frame.camera) in seen:
            problems.append(
                FormatError(
                    path,
                    field=field,
                    found=f"{frame.pattern} by {frame.camera} twice",
                    expected="one photograph each",
                )
            )
        seen.add((frame.pattern, frame.camera))
    if not session.file.sequence:
        problems.append(
            FormatError(path, field="sequence", found="no pattern", expected="at least one")
        )
    for index, pattern in enumerate(session.file.sequence):
        field = f"sequence[{index}]"
        if pattern in session.file.sequence[:index]:
            problems.append(
                FormatError(path, field=field, found=f"{pattern} again", expected="each once")
            )
            continue
        try:
            check_name(pattern, path, field)
            if pattern not in session.file.patterns:
                pattern_levels(pattern, session.rig)
        except (FormatError, PatternError) as error:
            problems.append(error)
    # Also of patterns that were not photographed: `full` sets the scale of the light.
    for pattern, driven in session.file.patterns.items():
        levels, count = np.array(driven.levels), len(session.rig.lights)
        field = f"patterns.{pattern}.levels"
        if len(levels) != count:
            problems.append(
                FormatError(
                    path, field=field, found=counted(len(levels), "level"), expected=str(count)
                )
            )
            continue
        for index in np.flatnonzero(~((levels >= 0) & (levels <= 1)))[:3]:
            problems.append(
                FormatError(
                    path, field=f"{field}[{index}]", found=str(levels[index]), expected="0..1"
                )
            )
    for name, file in session.file.calibration:
        if file is None:
            continue
        field = f"calibration.{name}"
        try:
            there = path_inside(session.root, file, path, field).is_file()
        except FormatError as error:
            problems.append(error)
            continue
        if not there:
            problems.append(
                FormatError(
                    path,
                    field=field,
                    found=f"no file {file}",
                    expected="a calibration file in the session, or null",
                )
            )
    return problems


def session_id(subject: str, expression: str, created_utc: str) -> str:
    """A short id from what a session is of and when."""
    text = json.dumps([subject, expression, created_utc])
    return hashlib.sha256(text.encode()).hexdigest()[:12]
