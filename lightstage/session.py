"""A session's life on disk: an append-only journal, photographs kept once, session.json at last.

The journal (journal.jsonl) is the record; session.json is made from it when all shots are there.
Events: ``begin`` (everything that was planned, who the devices are), ``frame`` (one photograph,
hashed as it lies on the disk), ``failed`` (one that did not come), ``shot`` (one pattern: all its
photographs are there and its light lasted through them; frames of a pattern without it do not
count), ``calibration``, ``end``.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import re
import secrets
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightstage.errors import CaptureError, ConfigError, FormatError
from lightstage.formats.files import check_schema, fsync_path, read_json, write_json
from lightstage.formats.session import (
    Calibration,
    Driven,
    Frame,
    SessionFile,
    save_session,
    session_id,
)
from lightstage.photograph import identify
from lightstage.rig import Rig, save_rig

SCHEMA = "lightstage.journal/1"
COLOUR_SCHEMA = "lightstage.colour/1"
COLOUR_PATH = "calibration/colour.json"


def utc_now() -> str:
    """The time as ISO 8601 in UTC, to the millisecond."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


def check_pseudonym(text: str, field: str) -> str:
    """A subject or expression as a session may carry it.

    Raises:
        ConfigError: empty, too long, or characters other than letters, digits, space . _ -: a path,
            an e-mail address or a control character must not get into a session.
    """
    if not re.fullmatch(r"[\w][\w .-]{0,63}", text):
        raise ConfigError(
            f"--{field}",
            found=repr(text),
            expected="1 to 64 letters, digits, spaces, dots, hyphens, underscores",
            hint="Use a pseudonym, never a name, an address or a path.",
        )
    return text


class Journal:
    """An append-only file of one JSON object a line, each on the disk before `write` returns.

    Several threads may write.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL, 0o644)
        self._lock = threading.Lock()
        fsync_path(path.parent)

    def write(self, event: str, **facts: Any) -> None:
        """Append one event with its time."""
        line = json.dumps({"event": event, "time_utc": utc_now(), **facts}, allow_nan=False)
        data = line.encode() + b"\n"
        with self._lock:
            if self._handle < 0:
                raise CaptureError(self.path, found="a journal that was closed", expected="open")
            if os.write(self._handle, data) != len(data):
                raise CaptureError(self.path, found="a cut line", expected="space on the disk")
            os.fsync(self._handle)

    def close(self) -> None:
        """Close the file; a later write is an error."""
        with self._lock:
            if self._handle >= 0:
                os.close(self._handle)
            self._handle = -1


def read_journal(path: Path) -> list[dict[str, Any]]:
    """Events of a journal, in order. A last line that was cut by a crash is passed over.

    Raises:
        FormatError: no journal, of another schema, or damaged before its last line.
    """
    if not path.is_file():
        raise FormatError(path, found="no such file", expected="the journal of a capture")
    lines = path.read_bytes().split(b"\n")
    events: list[dict[str, Any]] = []
    for number, line in enumerate(lines, 1):
        try:
            if line:
                events.append(json.loads(line))
        except ValueError as error:
            if number == len(lines):
                break
            raise FormatError(
                path, field=f"line {number}", found=str(error), expected="a JSON object"
            ) from None
    if not events or events[0].get("event") != "begin":
        raise FormatError(path, field="line 1", found="something else", expected="the event begin")
    check_schema(path, events[0], SCHEMA)
    return events


class SessionWriter:
    """Writes one session folder. A folder that holds something is never touched.

    Args:
        root: the folder to make.
        rig: saved with the session.
        patterns: names in order.
        subject: pseudonym.
        expression: such as ``neutral``.
        facts: what else the journal shall begin with (devices, configuration).

    Raises:
        CaptureError: the folder exists and is not empty.
    """

    def __init__(
        self,
        root: Path,
        rig: Rig,
        patterns: Sequence[str],
        subject: str,
        expression: str,
        facts: Mapping[str, Any],
    ) -> None:
        check_pseudonym(subject, "subject")
        check_pseudonym(expression, "expression")
        require_new(root)
        self.root = root
        created = utc_now()
        root.mkdir(parents=True, exist_ok=True)
        save_rig(rig, root / "rig.json")
        self._journal = Journal(root / "journal.jsonl")
        self._journal.write(
            "begin",
            schema=SCHEMA,
            id=session_id(subject, expression, created),
            created_utc=created,
            subject=subject,
            expression=expression,
            sequence=list(patterns),
            cameras=[camera.id for camera in rig.cameras],
            **facts,
        )

    def keep(self, pattern: str, camera: str, data: bytes, sha256: str, **facts: Any) -> Path:
        """Put one photograph on the disk and into the journal; several threads may.

        It is written under a temporary name, flushed, read back and hashed; only when that hash is
        the one that the driver took does it get its name, and never in place of another file.

        Args:
            pattern: what was lit.
            camera: who took it.
            data: the file's bytes.
            sha256: of the bytes where they came from.
            facts: for the journal.

        Returns:
            Where it lies.

        Raises:
            FormatError: no photograph, or a truncated one.
            CaptureError: the disk gave other bytes back, or the name is taken.
        """
        where = f"{pattern} by {camera}"
        kind = identify(data, where)
        relative = Path("frames") / pattern / f"{camera}{kind.suffix}"
        path = self.root / relative
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
        try:
            found = _write_and_read_back(beside, data)
            if found != sha256:
                raise CaptureError(
                    where,
                    field="sha256",
                    found=f"{found[:12]}.. on the disk",
                    expected=f"{sha256[:12]}.. as the camera gave it",
                    hint="Check the disk; the photograph is still on the camera.",
                )
            try:
                os.link(beside, path)  # unlike a rename, never replaces a file
            except FileExistsError:
                raise CaptureError(
                    path, found="a photograph of this name", expected="none yet"
                ) from None
        finally:
            beside.unlink(missing_ok=True)
        fsync_path(path.parent)
        self._journal.write(
            "frame",
            pattern=pattern,
            camera=camera,
            path=relative.as_posix(),
            sha256=sha256,
            encoding=kind.encoding,
            size=len(data),
            **facts,
        )
        return path

    def shot(self, pattern: str, levels: Sequence[float] | None, **facts: Any) -> None:
        """Journal that all photographs of a pattern are kept, and what was driven for it."""
        driven = {} if levels is None else {"levels": list(levels)}
        self._journal.write("shot", pattern=pattern, **driven, **facts)

    def note(self, event: str, **facts: Any) -> None:
        """Journal anything else, such as an error."""
        self._journal.write(event, **facts)

    def add_colour(self, value: dict[str, Any]) -> None:
        """Keep a colour calibration (as read by read_colour) in the session."""
        write_json(self.root / COLOUR_PATH, value)
        self._journal.write("calibration", colour=COLOUR_PATH)

    def finish(self) -> Path:
        """Write session.json from the journal as it lies on the disk; returns its path."""
        file = session_from_journal(self.root / "journal.jsonl")
        path = save_session(self.root, file)
        self._journal.write("end", frames=len(file.frames))
        return path

    def close(self) -> None:
        """Close the journal; the folder stays as it is."""
        self._journal.close()


def require_new(root: Path) -> None:
    """CaptureError when the folder for a new session exists and holds something."""
    if root.is_file() or (root.is_dir() and any(root.iterdir())):
        raise CaptureError(
            root,
            found="something there already",
            expected="a new folder",
            hint="Sessions are never overwritten; give another --out.",
        )


def session_from_journal(path: Path) -> SessionFile:
    """What session.json says, from a journal.

    Raises:
        FormatError: a shot of the sequence that was not finished.
    """
    events = read_journal(path)
    begin = events[0]
    frames = [
        Frame.model_validate({key: e[key] for key in Frame.model_fields})
        for e in events
        if e["event"] == "frame"
    ]
    patterns, cameras = begin["sequence"], begin["cameras"]
    frames.sort(key=lambda frame: (patterns.index(frame.pattern), cameras.index(frame.camera)))
    shots = {e["pattern"]: e for e in events if e["event"] == "shot"}
    missing = [pattern for pattern in begin["sequence"] if pattern not in shots]
    if missing:
        raise FormatError(
            path,
            found=f"no finished shot of {', '.join(missing)}",
            expected="all shots of the sequence",
        )
    calibration = {k: v for e in events if e["event"] == "calibration" for k, v in e.items()}
    return SessionFile(
        id=begin["id"],
        created_utc=begin["created_utc"],
        subject=begin["subject"],
        expression=begin["expression"],
        sequence=begin["sequence"],
        frames=frames,
        patterns={p: Driven(levels=s["levels"]) for p, s in shots.items() if "levels" in s},
        calibration=Calibration(colour=calibration.get("colour")),
    )


def read_colour(path: Path, rig: Rig) -> dict[str, Any]:
    """A colour calibration: for each camera a 3x3 matrix from raw to linear rgb.

    Raises:
        FormatError: another schema, or a camera of the rig without a finite 3x3 matrix.
    """
    value = read_json(path, COLOUR_SCHEMA)
    cameras = value.get("cameras", {})
    for camera in rig.cameras:
        matrix = cameras.get(camera.id, {}).get("linear_from_raw")
        try:
            rows = [[float(cell) for cell in row] for row in matrix]
        except (TypeError, ValueError):
            rows = []
        whole = len(rows) == 3 and all(len(row) == 3 for row in rows)
        if not whole or not all(abs(cell) < 1e6 for row in rows for cell in row):
            raise FormatError(
                path,
                field=f"cameras.{camera.id}.linear_from_raw",
                found=repr(matrix),
                expected="3 rows of 3 finite numbers",
            )
    return dict(value)


def _write_and_read_back(path: Path, data: bytes) -> str:
    """Write and flush a new file, then hash what the disk (not the cache) holds of it."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
    with os.fdopen(handle, "w+b") as file:
        file.write(data)
        file.flush()
        os.fsync(handle)
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()
