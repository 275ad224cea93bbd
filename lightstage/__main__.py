"""Commands of the stage: capture, retake, watch, check, import, calibrate, patterns."""

from __future__ import annotations

if __name__ == "__main__":
    from lightstage.interrupts import end_without_traceback

    end_without_traceback()  # until the imports below are done

import dataclasses
import sys
from pathlib import Path

import typer

from lightstage.calibrations import command as calibrations_command
from lightstage.capture import command as capture_command
from lightstage.capture import retake_command
from lightstage.checks import check_session
from lightstage.commands import JsonFlag, finish, make_app, progress_bar, run_app
from lightstage.motion import command as import_command
from lightstage.operator import command as operator_command
from lightstage.patterns import command as patterns_command

app = make_app("Drive the light stage: capture a session, check it, import one taken elsewhere.")
capture_command.register(app)
retake_command.register(app)
operator_command.register(app)
calibrations_command.register(app)
patterns_command.register(app)
import_command.register(app)


@app.command("check")
def check_command(
    session: Path = typer.Argument(help="Session folder."), as_json: bool = JsonFlag
) -> None:
    """Verify every hash, size, exposure and pattern of a session."""
    with progress_bar("check") as progress:
        report = check_session(session, progress)
    told = [finding for finding in report.findings if finding.severity != "note"]
    for finding in told:
        print(f"warning: {finding}", file=sys.stderr)
    finish(
        f"{session}: {report.frames} frames whole and unchanged, {report.sums} pattern sums "
        f"within {100 * report.worst_sum:.2f} %, at most {100 * report.clipped:.2f} % clipped, "
        f"{len(told)} warnings",
        {"session": str(session), **dataclasses.asdict(report)},
        as_json,
    )


def main() -> None:
    """Entry point of `lightstage`."""
    run_app(app)


if __name__ == "__main__":
    main()
