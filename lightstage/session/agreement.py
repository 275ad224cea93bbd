"""Whether a session's files agree: session.json and rig.json beside the journal."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightstage.errors import FormatError, LightstageError, one_error
from lightstage.formats.session import Frame, SessionFile, load_session, save_session
from lightstage.rig import load_rig
from lightstage.session.disk import disk_errors
from lightstage.session.events import Line
from lightstage.session.finished import session_from_lines
from lightstage.session.manifest import MANIFEST, check_manifest, write_manifest
from lightstage.session.opening import JOURNAL, RIG, rig_hash
from lightstage.session.present import damaged
from lightstage.session.reading import read_journal
from lightstage.session.state import SessionState

SESSION = "session.json"
OF_SESSION = ("id", "created_utc", "subject", "expression", "consent", "sequence", "accepted")
OF_FRAME = ("path", "sha256", "encoding", "take")
RESTORE = "Restore the file that was changed; the journal is what was written during the capture."


def disagreements(root: Path, session: SessionFile) -> list[LightstageError]:
    """Compare session.json and rig.json with the journal; no photograph is read.

    Args:
        root: the session's folder, which has a journal.
        session: the content of its session.json.

    Returns:
        One error for each field and photograph that differs, for lines that are missing in the
        middle of the journal, and for a capture whose journal has no end.
    """
    path = root / JOURNAL
    try:
        lines = read_journal(path)
        known = session_from_lines(lines, path)
        rig = rig_hash(load_rig(root / RIG))
    except LightstageError as error:
        return [error]
    problems = [*_gaps(lines, path), *_unlike_fields(root, session, known)]
    problems += _unlike_frames(root, session, known)
    if lines[0].get("rig_sha256", rig) != rig:
        problems.append(_wrong(root / RIG, "", "another rig than the journal's", "the same"))
    if "led_device" in lines[0] and lines[-1]["event"] != "end":
        problems.append(
            FormatError(
                path,
                found=f"{lines[-1]['event']} as its last line",
                expected="end",
                hint="The capture was not finished, or the file was cut: resume it, or restore "
                "the file.",
            )
        )
    return problems


def whole_session(root: Path) -> tuple[int, list[str]] | None:
    """Check a session that its journal calls finished: is it all there?

    Every photograph is read back from the disk; session.json and the manifest are compared. Where
    one of the two is lost or changed, it is written again: all of its content is in the journal.

    Args:
        root: the session's folder.

    Returns:
        How many photographs it has, and the names of the files that were written. None where it
        is not finished, or where something else is missing or changed that `--resume` brings in
        order with the cameras.

    Raises:
        FormatError: no journal, or one that was changed: what is right is not known then.
        CaptureError: the disk failed.
    """
    looked = _looked(root)
    records = (str(root / SESSION), str(root / MANIFEST))
    if looked is None or any(each.where not in records for each in looked.problems):
        return None
    written = []
    if any(each.where == records[0] for each in looked.problems):
        with disk_errors(root / SESSION):
            save_session(root, session_from_lines(looked.lines, root / JOURNAL))
        written.append(SESSION)
    # The manifest holds for the new session.json too where it has the bytes of the lost one.
    if check_manifest(root, looked.known):
        begin, end = looked.lines[0], looked.lines[-1]
        facts = {**(begin.get("facts") or {}), "capture": end.get("capture")}
        with disk_errors(root / MANIFEST):
            write_manifest(root, facts)
        written.append(MANIFEST)
    # With a manifest again, files that the journal does not know are seen.
    if written and (check_manifest(root, looked.known) or _unlike(root)):
        return None
    return looked.frames, written


@dataclasses.dataclass(frozen=True)
class _Looked:
    """The state of a finished session whose photographs are all whole."""

    lines: Sequence[Line]
    known: Mapping[str, str]
    problems: Sequence[LightstageError]

    @property
    def frames(self) -> int:
        return len(SessionState(self.lines).cameras) * len(self.lines[0]["sequence"])


def _looked(root: Path) -> _Looked | None:
    """The state of a session; None where it is not finished or photographs are not whole."""
    path = root / JOURNAL
    lines = read_journal(path)
    if lines[-1]["event"] != "end":
        return None
    frames = SessionState(lines).frames()
    if damaged(root, frames):
        return None
    known = {kept.path: kept.sha256 for kept in frames}
    problems = [*check_manifest(root, known), *_unlike(root)]
    changed = [each for each in problems if each.where == str(path)]
    if changed:
        raise one_error(changed)
    return _Looked(lines, known, problems)


def _unlike(root: Path) -> list[LightstageError]:
    if not (root / SESSION).exists():
        return [
            FormatError(root / SESSION, found="no such file", expected="the session's photographs")
        ]
    try:
        return disagreements(root, load_session(root).file)
    except LightstageError as error:
        return [error]


def _gaps(lines: Sequence[Line], path: Path) -> list[LightstageError]:
    """Ids count up by one; where one is left out, a line was removed."""
    return [
        _wrong(path, f"after id {before['id']}", f"id {after['id']}", str(before["id"] + 1))
        for before, after in itertools.pairwise([{"id": 0}, *lines])
        if after["id"] != before["id"] + 1
    ]


def _unlike_fields(root: Path, found: SessionFile, known: SessionFile) -> list[LightstageError]:
    path = root / SESSION
    problems: list[LightstageError] = [
        _wrong(path, name, repr(_field(found, name)), f"{_field(known, name)!r} ({JOURNAL})")
        for name in OF_SESSION
        if _field(found, name) != _field(known, name)
    ]
    problems += [
        _wrong(path, f"patterns.{pattern}.levels", "other levels", f"those of {JOURNAL}")
        for pattern in known.patterns
        if found.patterns.get(pattern) != known.patterns[pattern]
    ]
    return problems


def _unlike_frames(root: Path, found: SessionFile, known: SessionFile) -> list[LightstageError]:
    path = root / SESSION
    frames = {(frame.pattern, frame.camera): frame for frame in found.frames}
    problems: list[LightstageError] = []
    for frame in known.frames:
        other = frames.pop((frame.pattern, frame.camera), None)
        field = f"frame {frame.pattern} by {frame.camera}"
        if other is None:
            problems.append(_wrong(path, field, "no such frame", f"{frame.path} ({JOURNAL})"))
            continue
        for name in OF_FRAME:
            wrong, right = _field(other, name), _field(frame, name)
            if wrong != right:
                expected = f"{_short(right)} ({JOURNAL})"
                problems.append(_wrong(path, f"{field}, {name}", _short(wrong), expected))
    for pattern, camera in frames:
        expected = f"none ({JOURNAL})"
        problems.append(_wrong(path, f"frame {pattern} by {camera}", "a frame", expected))
    return problems


def _field(of: SessionFile | Frame, name: str) -> Any:
    """A field, or None: others than captures leave some out."""
    return getattr(of, name, None)


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) < 60 else f"{text[:12]}.."


def _wrong(path: Path, field: str, found: str, expected: str) -> FormatError:
    return FormatError(path, field=field, found=found, expected=expected, hint=RESTORE)
