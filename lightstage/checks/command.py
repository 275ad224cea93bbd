"""The command `check`: a session's files, patterns and records."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import sys
from pathlib import Path

import typer

from lightstage import __version__
from lightstage.checks import check_session
from lightstage.commands import JsonFlag, finish, progress_bar
from lightstage.counting import counted
from lightstage.errors import FormatError, LightstageError
from lightstage.findings import accepted_in_words
from lightstage.formats.access import group_of, limited_access
from lightstage.formats.checked import CHECKED, CHECKED_SCHEMA
from lightstage.formats.files import sha256_file, write_json


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("check")(check_command)


def check_command(
    session: Path = typer.Argument(help="Session folder."),
    record: bool = typer.Option(
        False, "--record", help="Note in the session's folder (checked.json) what came of it."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Verify every hash, size, exposure and pattern of a session, and that its files agree."""
    if not session.is_dir():
        raise FormatError(
            session,
            found="a file" if session.exists() else "no such folder",
            expected="a session's folder",
            hint="Give the folder that the capture was given with --out.",
        )
    with progress_bar("check") as progress:
        try:
            report = check_session(session, progress)
        except LightstageError as error:
            if record:
                with contextlib.suppress(LightstageError, OSError):  # the fault itself is reported
                    _record(session, str(error))
            raise
    shown = [finding for finding in report.findings if finding.severity != "note"]
    for finding in shown:
        print(f"warning: {finding}", file=sys.stderr)
    for sentence in report.unproven:
        print(f"note: {sentence}", file=sys.stderr)
    if record:
        _record(session, "", len(shown))
    accepted = accepted_in_words(len(report.accepted), sum(report.accepted.values()))
    finish(
        f"{session}: {counted(report.frames, 'photograph')} whole and unchanged, "
        f"{counted(report.sums, 'pattern sum')} "
        f"within {100 * report.worst_sum:.2f} %, at most {100 * report.clipped:.2f} % of a "
        "photograph clipped, "
        f"{accepted and accepted + ', '}{counted(len(shown), 'warning')} "
        "of what is there",
        {"session": str(session), **dataclasses.asdict(report)},
        as_json,
    )


def _record(session: Path, failed: str, warnings: int = 0) -> None:
    """Note what a check found beside the session.json that it was made of."""
    file = session / "session.json"
    with limited_access(group_of([session])):
        write_json(
            session / CHECKED,
            {
                "schema": CHECKED_SCHEMA,
                "time_utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                "version": __version__,
                "passed": not failed,
                "warnings": warnings,
                "said": failed,
                "session_sha256": sha256_file(file) if file.is_file() else "",
            },
        )
