"""Whether each photograph of a session is its own: of no other session, and not older than it."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path

from lightstage.errors import FormatError, LightstageError
from lightstage.exif import read_exif
from lightstage.findings import Finding
from lightstage.formats.session import Session
from lightstage.session import read_journal
from lightstage.session.camera_clock import GRAIN_S, ZONE_S, Verdict, judge_time
from lightstage.session.events import Line
from lightstage.session.neighbours import Neighbours
from lightstage.session.opening import JOURNAL
from lightstage.session.state import CLOCK_SET

HINT = "The camera gave an old photograph; retake it."


def strangers(session: Session) -> tuple[list[LightstageError], list[Finding]]:
    """RAW photographs with the bytes of one in a folder beside the session.

    Returns:
        Errors where the session was captured; findings where its photographs were imported, which
        somebody may do twice.
    """
    beside = Neighbours(session.root)
    imported = not any("led_device" in line for line in _lines(session.root)[:1])
    problems: list[LightstageError] = []
    findings: list[Finding] = []
    for frame in session.file.frames:
        whose = beside.whose(frame.sha256) if frame.encoding == "raw" else None
        if whose is None:
            continue
        path, found, expected = session.frame_path(frame), f"the bytes of {whose}", "its own"
        if imported:
            hint = "Was one folder imported twice?"
            findings.append(
                Finding(
                    "warn", "of-another-session", str(path), found, expected, hint,
                    frame.pattern, frame.camera,
                )
            )  # fmt: skip
        else:
            problems.append(
                FormatError(path, field="sha256", found=found, expected=expected, hint=HINT)
            )
    return problems, findings


def too_old(session: Session) -> list[LightstageError]:
    """Photographs whose time in the file is before the session began, by their camera's clock.

    The clock is that of the journal's ``exposed`` lines. What is whole quarters of an hour off may
    be of another time zone and passes; so does what was taken when the clock was being set.
    """
    lines = _lines(session.root)
    if not lines:
        return []
    exposed = {_key(line): line for line in lines if line["event"] == "exposed"}
    taken_of = {line.get("path"): _key(line) for line in lines if line["event"] == "frame"}
    was_set = [line.get("file") for line in lines if line.get("about") == CLOCK_SET]
    begun = datetime.datetime.fromisoformat(lines[0]["created_utc"])
    problems: list[LightstageError] = []
    for frame in session.file.frames:
        line = exposed.get(taken_of.get(frame.path, ("", "", 0)))
        path = session.frame_path(frame)
        if line is None or line.get("clock_offset_s") is None or not path.is_file():
            continue
        taken = read_exif(path).taken
        if line["file"] not in was_set and taken is not None and _is_before(taken, line, begun):
            problems.append(
                FormatError(
                    path,
                    field="time in the file",
                    found=str(taken),
                    expected=f"later than {begun.isoformat(' ', 'seconds')}, when the session "
                    f"began (the camera's clock was {line['clock_offset_s']:+.0f} s off)",
                    hint=HINT,
                )
            )
    return problems


def _is_before(taken: datetime.datetime, exposed: Line, begun: datetime.datetime) -> bool:
    offset = datetime.timedelta(seconds=exposed["clock_offset_s"])
    lasted_s = float(exposed.get("exposure_s", 0.0))
    exposed_at = datetime.datetime.fromisoformat(exposed["time_utc"])
    shot = exposed_at + offset - datetime.timedelta(seconds=lasted_s)
    if judge_time(taken, shot, lasted_s) is not Verdict.DIFFERS:
        return False
    zoned = taken if taken.tzinfo is not None else taken.replace(tzinfo=datetime.UTC)
    off_s = (zoned - shot).total_seconds()
    zone_s = 0.0 if taken.tzinfo is not None else round(off_s / ZONE_S) * ZONE_S
    began_ago_s = (exposed_at - begun).total_seconds() - lasted_s
    return off_s - zone_s < -began_ago_s - GRAIN_S


def _lines(root: Path) -> Sequence[Line]:
    """The journal's lines; none where there is no readable one, which is another check's."""
    try:
        return read_journal(root / JOURNAL)
    except FormatError:
        return []


def _key(line: Line) -> tuple[str, str, int]:
    return line["pattern"], line["camera"], line["take"]
