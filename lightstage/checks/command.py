"""The command `check`: a session's files, patterns and records."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import typer

from lightstage.checks import check_session
from lightstage.commands import JsonFlag, finish, progress_bar
from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.findings import accepted_in_words


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("check")(check_command)


def check_command(
    session: Path = typer.Argument(help="Session folder."), as_json: bool = JsonFlag
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
        report = check_session(session, progress)
    told = [finding for finding in report.findings if finding.severity != "note"]
    for finding in told:
        print(f"warning: {finding}", file=sys.stderr)
    for sentence in report.unproven:
        print(f"note: {sentence}", file=sys.stderr)
    accepted = accepted_in_words(len(report.accepted), sum(report.accepted.values()))
    finish(
        f"{session}: {counted(report.frames, 'frame')} whole and unchanged, "
        f"{counted(report.sums, 'pattern sum')} "
        f"within {100 * report.worst_sum:.2f} %, at most {100 * report.clipped:.2f} % of a "
        "photograph clipped, "
        f"{accepted and accepted + ', '}{counted(len(told), 'warning')} "
        "of what lies there",
        {"session": str(session), **dataclasses.asdict(report)},
        as_json,
    )
