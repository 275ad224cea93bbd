"""LAB/KIND-UTC/calibration.json: one folder of calibration shots, a session for each pose.

calibration.json is there from the beginning, and states when it was finished; unfinished shots
count for nothing and can be resumed.
"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lightstage.errors import FormatError, LightstageError, one_error
from lightstage.formats.files import read_json, sha256_file, write_json
from lightstage.formats.paths import path_inside
from lightstage.formats.validation import validation_error

SCHEMA = "lightstage.calibration-shots/1"
NAME = "calibration.json"
MANIFEST = "manifest.json"


class Pose(BaseModel):
    """One pose that was taken and is usable."""

    model_config = ConfigDict(extra="allow", frozen=True)

    index: int
    folder: str
    faces: str | None
    session_sha256: str
    manifest_sha256: str | None
    figures: dict[str, dict[str, Any]]
    accepted: list[str] = []
    """What was amiss with it and accepted by the operator."""


class Devices(BaseModel):
    """Who took the shots."""

    model_config = ConfigDict(extra="allow", frozen=True)

    cameras: dict[str, dict[str, str | None]]
    leds: dict[str, Any]


class CalibrationFile(BaseModel):
    """calibration.json."""

    model_config = ConfigDict(extra="allow", frozen=True, populate_by_name=True)

    schema_: str = Field(alias="schema", default=SCHEMA)
    id: str
    kind: str
    created_utc: str
    finished_utc: str | None = None
    expires_utc: str
    rig_sha256: str
    devices: Devices
    patterns: list[str]
    poses_wanted: int
    poses: list[Pose] = []
    takes: dict[str, int] = {}
    """How often each pose's folder was begun, by its index."""

    @property
    def created(self) -> datetime.datetime:
        """When they were begun."""
        return datetime.datetime.fromisoformat(self.created_utc)

    @property
    def expires(self) -> datetime.datetime:
        """When they end to hold by age alone."""
        return datetime.datetime.fromisoformat(self.expires_utc)

    def age_days(self, now: datetime.datetime) -> float:
        """Days since they were begun; negative where the clock went backward."""
        return (now - self.created).total_seconds() / 86400


class Shots:
    """One folder of calibration shots.

    Attributes:
        root: LAB/KIND-UTC.
        file: its calibration.json.
    """

    def __init__(self, root: Path, file: CalibrationFile) -> None:
        self.root = root
        self.file = file

    @property
    def sha256(self) -> str:
        """Of calibration.json, which holds the hashes of all that is beside it."""
        return sha256_file(self.root / NAME)

    def save(self) -> None:
        """Write calibration.json atomically."""
        write_json(self.root / NAME, self.file.model_dump(by_alias=True, mode="json"))

    def changed(self) -> list[LightstageError]:
        """One error for each pose whose session or manifest is missing or was changed since."""
        problems: list[LightstageError] = []
        for pose in self.file.poses:
            hashes = {"session.json": pose.session_sha256, MANIFEST: pose.manifest_sha256}
            for name, sha256 in hashes.items():
                path = self.root / pose.folder / name
                if sha256 is None or (path.is_file() and sha256_file(path) == sha256):
                    continue
                problems.append(
                    FormatError(
                        path,
                        field="sha256",
                        found="another file" if path.is_file() else "no such file",
                        expected=f"{sha256[:12]}.. ({NAME})",
                        hint="Bring it back from a copy, or take these shots again.",
                    )
                )
        return problems


def read_shots(root: Path) -> Shots:
    """Read a folder of calibration shots.

    Raises:
        FormatError: no calibration.json, or every field of it that is wrong, in one message; a
            pose's folder that is not in this one is wrong too.
    """
    path = root / NAME
    value = read_json(path, SCHEMA)
    try:
        file = CalibrationFile.model_validate(value)
        times = file.created, file.expires
        if any(time.tzinfo is None for time in times):
            raise ValueError("a time without its zone")
    except ValidationError as error:
        raise validation_error(error, path) from None
    except ValueError as error:
        raise FormatError(
            path, field="created_utc, expires_utc", found=str(error), expected="ISO 8601 with zone"
        ) from None
    outside: list[LightstageError] = []
    for index, pose in enumerate(file.poses):
        try:
            path_inside(root, pose.folder, path, f"poses[{index}].folder")
        except FormatError as error:
            outside.append(error)
    if outside:
        raise one_error(outside)
    return Shots(root, file)
