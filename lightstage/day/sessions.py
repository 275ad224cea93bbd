"""The sessions of a folder: whose, of when, whole or not, checked or not, processed or not."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from lightstage.counting import counted
from lightstage.day.plan import take_folder
from lightstage.errors import FormatError, LightstageError
from lightstage.formats.checked import CHECKED, CHECKED_SCHEMA
from lightstage.formats.files import read_json, sha256_file
from lightstage.formats.paths import path_inside
from lightstage.formats.session import load_session, missing_frames
from lightstage.formats.values import LINE, open_regular, parse_json
from lightstage.operator.client import answers
from lightstage.operator.journal_stream import JournalTail
from lightstage.operator.view import View
from lightstage.operator.words import text_of
from lightstage.printable import printable, printable_lines
from lightstage.session.opening import JOURNAL
from lightstage.session.reading import no_journal

State = Literal["whole", "running", "unfinished", "damaged"]
Checked = Literal["passed", "failed", "changed since", "not checked"]
TAIL_BYTES = 1 << 16
"""Bytes that are read from a journal's end, for its last line."""
MOST_FOLDERS = 10_000


@dataclasses.dataclass(frozen=True)
class Seen:
    """The state of a session's folder; of photographs only their sizes are read.

    Attributes:
        root: the folder.
        session: its id; empty where it is damaged.
        subject: pseudonym.
        expression: such as ``neutral``.
        created_utc: when it began.
        consent: id of the record of the person's consent; None where there is none.
        state: whole, running, not finished, or damaged.
        kept: photographs that are there.
        wanted: photographs of the whole session.
        accepted: patterns that the operator accepted with faults.
        findings: how many faults these are.
        checked: what `lightstage check --record` noted.
        why: what a check found that failed; otherwise empty.
        processed: processed folders that were made from it.
        said: what is wrong with a damaged session; otherwise empty. One whose journal is whole has
            all else as well.
    """

    root: Path
    session: str = ""
    subject: str = ""
    expression: str = ""
    created_utc: str = ""
    consent: str | None = None
    state: State = "damaged"
    kept: int = 0
    wanted: int = 0
    accepted: int = 0
    findings: int = 0
    checked: Checked = "not checked"
    why: str = ""
    processed: tuple[Path, ...] = ()
    said: str = ""

    @property
    def date(self) -> str:
        """When it began, to the minute (UTC)."""
        return self.created_utc[:16].replace("T", " ")

    @property
    def time(self) -> str:
        """The same without the day."""
        return self.date[11:]

    @property
    def take(self) -> int | None:
        """Number of this take of the person with the expression, as a plan names its folder."""
        first = take_folder(self.subject, self.expression, 1)
        number = self.root.name.removeprefix(f"{first}+")
        if self.root.name == first:
            return 1
        return int(number) if number != self.root.name and number.isdecimal() else None


def sessions_of(folder: Path, processed: Path | None = None) -> list[Seen]:
    """The sessions in a folder, those that began first before the others.

    Args:
        folder: holds sessions' folders, or is a session itself.
        processed: holds processed folders.

    Raises:
        FormatError: no folder, or one that cannot be read.
    """
    made = {} if processed is None else processed_of(processed)
    alone = (folder / JOURNAL).is_file() or (folder / "session.json").is_file()
    seen = [
        dataclasses.replace(each, processed=tuple(made.get(each.session, ())))
        for path in ([folder] if alone else session_folders(folder))
        if (each := seen_session(path)) is not None
    ]
    return sorted(seen, key=lambda each: (each.created_utc, each.root.name))


def session_folders(folder: Path) -> list[Path]:
    """Folders in a folder that hold a session, by name; errors as `sessions_of`."""
    try:
        names = sorted(entry.name for entry in os.scandir(folder) if entry.is_dir())
    except OSError as error:
        raise FormatError(
            folder,
            found="no such folder"
            if isinstance(error, FileNotFoundError)
            else error.strerror or "",
            expected="a folder of sessions",
        ) from None
    paths = [folder / name for name in names[:MOST_FOLDERS] if not name.startswith(".")]
    return [p for p in paths if (p / JOURNAL).exists() or (p / "session.json").exists()]


def seen_session(root: Path) -> Seen | None:
    """The state of one session; None where the folder holds none."""
    try:
        if (root / JOURNAL).exists():
            seen = _by_journal(root)
        elif (root / "session.json").exists():
            seen = _by_session_file(root)
        else:
            return None
        checked, why = _checked(root)
        return dataclasses.replace(seen, checked=checked, why=why)
    except (LightstageError, OSError) as error:
        return Seen(root, said=str(error))


def _by_journal(root: Path) -> Seen:
    begin, last = _ends(root / JOURNAL)
    patterns, cameras = begin.get("sequence"), begin.get("cameras")
    sizes = [len(each) if isinstance(each, list) else 0 for each in (patterns, cameras)]
    wanted = sizes[0] * sizes[1]
    consent = begin.get("consent")
    seen = Seen(
        root,
        text_of(begin, "session") or text_of(begin, "id"),
        text_of(begin, "subject"),
        text_of(begin, "expression"),
        text_of(begin, "created_utc"),
        consent if isinstance(consent, str) else None,
        "whole",
        wanted,
        wanted,
    )
    if last.get("event") == "end":
        report = last.get("capture")
        counts = report if isinstance(report, dict) else {}
        accepted, findings = (
            value if type(value := counts.get(name)) is int else 0
            for name in ("accepted", "accepted_findings")
        )
        return _held_against_disk(dataclasses.replace(seen, accepted=accepted, findings=findings))
    if "led_device" not in begin and (root / "session.json").is_file():  # imported
        return _held_against_disk(seen)
    # Few sessions are unfinished: their journals are read whole.
    view = View(str(root))
    with JournalTail(root / JOURNAL) as tail:
        for line in tail.read():
            view.receive(line)
    running = not view.over and answers(root)
    return dataclasses.replace(seen, state="running" if running else "unfinished", kept=view.kept)


def _held_against_disk(seen: Seen) -> Seen:
    """A session that ended; damaged where a photograph is not there, or has another size."""
    file = (seen.root / JOURNAL).stat()
    lost = [
        str(path.relative_to(seen.root.resolve()))
        for path, size in _counting(seen.root.resolve(), file.st_mtime_ns, file.st_size)
        if not path.is_file() or size not in (None, path.stat().st_size)
    ]
    if not lost:
        return seen
    more = f" and {counted(len(lost) - 1, 'other')}" if lost[1:] else ""
    said = FormatError(
        seen.root,
        found=f"{lost[0]}{more} missing or of another size",
        expected="every photograph as it was kept",
        hint="Copy it back from where it is whole, or take it again: lightstage retake.",
    )
    kept = max(0, seen.wanted - len(lost))
    return dataclasses.replace(seen, state="damaged", kept=kept, said=str(said))


@functools.lru_cache(maxsize=1024)
def _counting(root: Path, time_ns: int, size: int) -> tuple[tuple[Path, int | None], ...]:
    """Files and sizes of the photographs that count, of a journal of this time and size.

    The size is None where the journal, of an earlier version, does not have it.
    `SessionState.accepted` has the same rule, on a journal whose every line is checked and whose
    levels, megabytes of them, are read; a list of sessions does without both.
    """
    del time_ns, size  # they are the cache's: the journal of an ended session hardly ever changes
    takes: dict[tuple[str, str], dict[int, tuple[Path, int | None]]] = {}
    with JournalTail(root / JOURNAL) as tail:
        for line in tail.read():
            key, take = (text_of(line, "pattern"), text_of(line, "camera")), line.get("take")
            if type(take) is not int:
                continue
            if line.get("event") == "frame":
                path = path_inside(root, line.get("path"), root / JOURNAL, "path")
                length = line.get("size")
                known = length if type(length) is int and length > 0 else None
                takes.setdefault(key, {})[take] = path, known
            elif line.get("event") == "rejected":
                takes.get(key, {}).pop(take, None)
    return tuple(of_key[max(of_key)] for of_key in takes.values() if of_key)


def _ends(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """A journal's first line, and its last whole one."""
    with open(open_regular(path, "the journal of a capture"), "rb") as file:
        # It holds the levels of every pattern: megabytes where single lamps of a thousand are lit.
        head = file.readline(LINE.size_bytes + 1)
        file.seek(max(0, os.fstat(file.fileno()).st_size - TAIL_BYTES))
        tail = file.read(TAIL_BYTES)
    try:
        first = parse_json(head.removesuffix(b"\n"), path, LINE)
    except FormatError:
        first = None
    if not isinstance(first, dict) or first.get("event") != "begin":
        raise no_journal(path, head)
    last: Any = {}
    for raw in reversed(tail.split(b"\n")):
        try:
            last = parse_json(raw, path, LINE)
        except FormatError:
            continue
        break
    return first, last if isinstance(last, dict) else {}


def _by_session_file(root: Path) -> Seen:
    """A session without a journal: whole where every photograph of the grid is there."""
    session = load_session(root)
    file, wanted = session.file, len(session.file.sequence) * len(session.rig.cameras)
    absent = len(missing_frames(session))
    consent = (file.model_extra or {}).get("consent")
    return Seen(
        root,
        printable(file.id),
        file.subject,
        file.expression,
        printable(file.created_utc),
        consent if isinstance(consent, str) and consent else None,
        "unfinished" if absent else "whole",
        wanted - absent,
        wanted,
    )


def _checked(root: Path) -> tuple[Checked, str]:
    """What a check noted, and why it failed."""
    path, session = root / CHECKED, root / "session.json"
    if not path.exists():
        return "not checked", ""
    try:
        value = read_json(path, CHECKED_SCHEMA)
    except LightstageError:
        return "not checked", ""
    now = sha256_file(session) if session.is_file() else ""
    if value.get("session_sha256") != now:
        return "changed since", ""
    if value.get("passed") is True:
        return "passed", ""
    return "failed", printable_lines(str(value.get("said") or ""))


def processed_of(folder: Path) -> dict[str, list[Path]]:
    """Processed folders in a folder, by the id of the session that they were made from.

    Folders that are no processed folders, or cannot be read, are skipped.
    """
    found: dict[str, list[Path]] = {}
    try:
        paths = sorted(Path(entry.path) for entry in os.scandir(folder) if entry.is_dir())
    except OSError:
        return found
    for path in paths[:MOST_FOLDERS]:
        session = _made_from(path / "report.json")
        if session:
            found.setdefault(session, []).append(path)
    return found


def _made_from(report: Path) -> str:
    try:
        value = read_json(report) if report.exists() else None
    except LightstageError:
        return ""
    return text_of(value, "session") if isinstance(value, dict) else ""


def in_words(sessions: Iterable[Seen]) -> str:
    """How many there are, and how many of them are whole, checked and processed."""
    seen = list(sessions)
    whole = sum(each.state == "whole" for each in seen)
    checked = sum(each.checked == "passed" for each in seen)
    made = sum(bool(each.processed) for each in seen)
    return f"{whole} whole, {checked} checked, {made} processed"
