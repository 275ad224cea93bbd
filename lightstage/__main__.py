"""Commands of the stage: capture, watch, check, import, calibrate, patterns."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import typer

from lightstage.calibrations import command as calibration_command
from lightstage.calibrations import command as calibrations_command
from lightstage.capture import command as capture_command
from lightstage.checks import check_session
from lightstage.commands import JsonFlag, finish, make_app, progress_bar, run_app
from lightstage.importing import import_session
from lightstage.operator import command as operator_command
from lightstage.patterns import command as patterns_command
from lightstage.rig import load_rig
from lightstage.session import read_calibration

app = make_app("Drive the light stage: capture a session, check it, import one taken elsewhere.")
capture_command.register(app)
calibration_command.register(app)
operator_command.register(app)
calibrations_command.register(app)
patterns_command.register(app)


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


@app.command("import")
def import_command(
    folder: Path = typer.Argument(help="Holds PATTERN/CAMERA.EXT (RAW, DNG or linear OpenEXR)."),
    rig: Path = typer.Option(..., "--rig", help="rig.json: where lights and cameras stand."),
    out: Path = typer.Option(..., "--out", help="The session's folder, new."),
    subject: str = typer.Option("subject-1", help="Pseudonym of the person."),
    expression: str = typer.Option("neutral"),
    colour: Path | None = typer.Option(
        None, help="A calibration folder, or a colour calibration alone."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Make a session of photographs taken elsewhere."""
    the_rig = load_rig(rig)
    calibration = None if colour is None else read_calibration(colour, the_rig)
    with progress_bar("import") as progress:
        frames = import_session(folder, the_rig, out, subject, expression, calibration, progress)
    finish(f"{out}: {frames} frames imported", {"session": str(out), "frames": frames}, as_json)


def main() -> None:
    """Entry point of `lightstage`."""
    run_app(app)


if __name__ == "__main__":
    main()
