"""This computer's clock against the journals of a session and of those that are beside it."""

from __future__ import annotations

import dataclasses
import datetime
import os
from pathlib import Path

from lightstage.errors import FormatError
from lightstage.findings import Finding
from lightstage.formats.values import LINE, open_regular, parse_json
from lightstage.preflight.config import PreflightConfig

JOURNALS = 50
"""So many are read, the newest files first."""
TAIL_BYTES = 1 << 20
CLOCK_GRAIN_S = 2.0


@dataclasses.dataclass(frozen=True)
class Newest:
    """The newest line of the journals of a folder.

    Attributes:
        time: of the line; None where no journal has one.
        path: its journal.
        unread: journals that could not be read, and why.
    """

    time: datetime.datetime | None
    path: Path | None
    unread: tuple[FormatError, ...]


def computer_clock_findings(
    out: Path, config: PreflightConfig, now: datetime.datetime | None = None
) -> list[Finding]:
    """This computer's clock against the journals of this session and of those beside it.

    Args:
        out: the session's folder.
        config: the first year, and whether a journal of the future is a warning alone.
        now: with a zone; the present where None.
    """
    now = now or datetime.datetime.now(datetime.UTC)
    now_text = now.isoformat(timespec="seconds")
    hint = "Set this computer's clock (timedatectl set-ntp true)."
    if now.year < config.first_year:
        wanted = f"{config.first_year} or later"
        return [Finding("refuse", "computer-clock", "this computer, clock", now_text, wanted, hint)]
    newest = newest_journal(out)
    findings = [
        Finding(
            "warn",
            "journal-unread",
            error.where,
            error.found,
            "a journal whose last line has its time",
            "It is skipped. Repair it, or move its folder away.",
        )
        for error in newest.unread
    ]
    if newest.time is not None and (newest.time - now).total_seconds() > CLOCK_GRAIN_S:
        ignored = "It is ignored, as was asked for." if config.ignore_clock else ""
        findings.append(
            Finding(
                "warn" if config.ignore_clock else "refuse",
                "computer-clock",
                "this computer, clock",
                now_text,
                f"later than the last line of {newest.path}, "
                f"{newest.time.isoformat(timespec='seconds')}",
                ignored
                or f"{hint} If the clock is right, that journal was written under a wrong one: "
                "give --ignore-clock.",
            )
        )
    return findings


def newest_journal(out: Path) -> Newest:
    """Latest ``time_utc`` at the end of the journals in a session's folder and beside it."""
    newest, its, unread = None, None, []
    for path in _journals(out):
        try:
            time = _last_time(path)
        except FormatError as error:
            unread.append(error)
            continue
        if time is not None and (newest is None or time > newest):
            newest, its = time, path
    return Newest(newest, its, tuple(unread))


def _journals(out: Path) -> list[Path]:
    """Journals in the folders beside `out` and in itself, the newest files first."""
    dated = []
    try:
        folders = sorted(out.absolute().parent.iterdir())
    except OSError:
        return []
    for folder in folders:
        path = folder / "journal.jsonl"
        try:
            dated.append((path.stat().st_mtime, path))
        except OSError:  # no session
            continue
    return [path for _, path in sorted(dated, reverse=True)[:JOURNALS]]


def _last_time(path: Path) -> datetime.datetime | None:
    """When a journal's last whole line was written; None for an empty one.

    Raises:
        FormatError: no regular file, or no line that has a time.
    """
    handle = open_regular(path, "a journal")
    try:
        size = os.fstat(handle).st_size
        data = os.pread(handle, TAIL_BYTES, max(0, size - TAIL_BYTES))
    except OSError as error:
        raise FormatError(path, found=error.strerror or str(error)) from None
    finally:
        os.close(handle)
    for text in reversed(data.split(b"\n")):
        try:
            line = parse_json(text, path, LINE)
            time = datetime.datetime.fromisoformat(line["time_utc"])
        except (FormatError, ValueError, KeyError, TypeError):
            continue  # half a line, or a damaged one
        if time.tzinfo is not None:
            return time
    if not size:
        return None
    raise FormatError(path, found="no line that has a time with its zone")
