"""A lab's folders of calibration shots: begun, listed, the newest of a kind."""

from __future__ import annotations

import datetime
import hashlib
from pathlib import Path

from lightstage.errors import CaptureError, FormatError, LightstageError
from lightstage.formats.calibration_shots import NAME, CalibrationFile, Shots, read_shots


def shots_id(kind: str, created_utc: str, rig_sha256: str) -> str:
    """A short id of what was begun when, on which stage."""
    return hashlib.sha256(f"{kind}\n{created_utc}\n{rig_sha256}".encode()).hexdigest()[:12]


def folder_name(kind: str, created: datetime.datetime) -> str:
    """The folder's name in its lab."""
    return f"{kind}-{created.astimezone(datetime.UTC):%Y%m%dT%H%M%SZ}"


def new_shots(lab: Path, file: CalibrationFile) -> Shots:
    """Make the folder of new shots; CaptureError where there is one of that second."""
    root = lab / folder_name(file.kind, file.created)
    try:
        root.mkdir(parents=True)
    except FileExistsError:
        raise CaptureError(
            root, found="shots of this very second", expected="a new folder", hint="Try again."
        ) from None
    except OSError as error:
        raise CaptureError(
            lab, found=error.strerror or str(error), expected="a folder that can be written to"
        ) from None
    shots = Shots(root, file)
    shots.save()
    return shots


def lab_shots(lab: Path) -> tuple[list[Shots], list[LightstageError]]:
    """All calibration shots of a lab, oldest first, and what of it cannot be read.

    Raises:
        FormatError: no such folder.
    """
    if not lab.is_dir():
        raise FormatError(
            lab,
            found="no such folder" if not lab.exists() else "a file",
            expected="a lab's folder of calibration shots",
            hint="`lightstage calibrate KIND --out LAB` makes it.",
        )
    found: list[Shots] = []
    problems: list[LightstageError] = []
    for path in sorted(lab.glob(f"*/{NAME}")):
        try:
            found.append(read_shots(path.parent))
        except FormatError as error:
            problems.append(error)
    return sorted(found, key=lambda shots: shots.file.created), problems


def latest(lab: Path, kind: str) -> Shots | None:
    """The newest finished shots of a kind; None where there are none."""
    shots, _ = lab_shots(lab)
    finished = [s for s in shots if s.file.kind == kind and s.file.finished_utc is not None]
    return finished[-1] if finished else None


def newest_unfinished(lab: Path, kind: str) -> Shots:
    """The newest shots of a kind that were begun and not finished.

    Raises:
        FormatError: there are none.
    """
    shots, _ = lab_shots(lab)
    begun = [s for s in shots if s.file.kind == kind and s.file.finished_utc is None]
    if not begun:
        raise FormatError(
            lab,
            found=f"no unfinished {kind} shots",
            expected="a folder to resume",
            hint="Leave out --resume to begin new ones.",
        )
    return begun[-1]
