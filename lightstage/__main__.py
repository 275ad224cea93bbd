"""Commands of the stage: capture, check, import."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import typer

from lightstage import __version__
from lightstage.cameras.binding import (
    CamerasFile,
    close_cameras,
    find_cameras,
    read_cameras_file,
)
from lightstage.cameras.process import detect_ports
from lightstage.capture import CaptureConfig, capture, connect, worst_shot_s
from lightstage.checks import check_session
from lightstage.commands import JsonFlag, finish, make_app, progress_bar, run_app
from lightstage.formats.config import as_dict, make_config, read_toml
from lightstage.importing import import_session
from lightstage.leds.address import parse_url
from lightstage.leds.opening import open_leds
from lightstage.patterns import sequence_patterns
from lightstage.rig import load_rig
from lightstage.safety import check_shots
from lightstage.sequence import plan_shots
from lightstage.session import SessionPlan, SessionWriter, check_pseudonym, read_colour, require_new

app = make_app("Drive the light stage: capture a session, check it, import one taken elsewhere.")

RigOption = typer.Option(..., "--rig", help="rig.json: where lights and cameras stand.")
OutOption = typer.Option(..., "--out", help="The session's folder, new.")
SubjectOption = typer.Option("subject-1", "--subject", help="Pseudonym of the person.")
ExpressionOption = typer.Option("neutral", "--expression")
ColourOption = typer.Option(None, "--colour", help="Colour calibration (lightstage.colour/1).")


@app.command("capture")
def capture_command(
    rig: Path = RigOption,
    sequence: str = typer.Option("binary", help="Named sequence, or pattern names with commas."),
    out: Path = OutOption,
    leds: str = typer.Option(..., help="serial:///dev/ttyX?baud=.. or pty:///dev/pts/N?.."),
    cameras: str = typer.Option("auto", help="A cameras file (TOML), or auto: by serial number."),
    subject: str = SubjectOption,
    expression: str = ExpressionOption,
    colour: Path | None = ColourOption,
    config: Path | None = typer.Option(None, help="TOML with values that differ from defaults."),
    as_json: bool = JsonFlag,
) -> None:
    """Light, photograph and verify every pattern; lights end dark whatever happens."""
    check_pseudonym(subject, "subject")
    check_pseudonym(expression, "expression")
    require_new(out)
    the_rig = load_rig(rig)
    shots = plan_shots(sequence_patterns(sequence), the_rig)
    settings = CaptureConfig()
    if config is not None:
        settings = make_config(CaptureConfig, read_toml(config), config)
    address = parse_url(leds)
    worst_s = worst_shot_s(settings, address.worst_s)
    check_shots(shots, the_rig, settings.safety, worst_s)
    file = CamerasFile() if cameras == "auto" else read_cameras_file(Path(cameras))
    calibration = None if colour is None else read_colour(colour, the_rig)

    with open_leds(address, len(the_rig.lights)) as lights:
        devices = find_cameras(the_rig, file, settings.camera_deadline_s, detect_ports)
        try:
            told = connect(the_rig, lights, devices, file.allow_unverifiable)
            facts = {
                "version": __version__,
                "led_device": dataclasses.asdict(lights.hello),
                "told": {d.id: dataclasses.asdict(s) for d, s in zip(devices, told, strict=True)},
                "not_verifiable": {d.id: s.untold() for d, s in zip(devices, told, strict=True)},
                "config": as_dict(settings),
            }
            patterns = [shot.pattern for shot in shots]
            plan = SessionPlan(tuple(patterns), subject, expression)
            writer = SessionWriter.new(out, the_rig, plan, facts=facts)
            try:
                if calibration is not None:
                    writer.add_colour(calibration)
                with progress_bar("capture") as progress:
                    report = capture(shots, lights, devices, writer, settings, progress)
            finally:
                writer.close()
        finally:
            close_cameras(devices)
    finish(
        f"{out}: {report.frames} frames in {report.seconds:.1f} s, "
        f"overhead {report.overhead_s:.2f} s, "
        f"largest trigger skew {1e3 * report.max_skew_s:.2f} ms",
        {"session": str(out), **dataclasses.asdict(report)},
        as_json,
    )


@app.command("check")
def check_command(
    session: Path = typer.Argument(help="Session folder."), as_json: bool = JsonFlag
) -> None:
    """Verify every hash, size, exposure and pattern of a session."""
    with progress_bar("check") as progress:
        report = check_session(session, progress)
    finish(
        f"{session}: {report.frames} frames whole and unchanged, {report.sums} pattern sums "
        f"within {100 * report.worst_sum:.2f} %, at most {100 * report.clipped:.2f} % clipped",
        {"session": str(session), **dataclasses.asdict(report)},
        as_json,
    )


@app.command("import")
def import_command(
    folder: Path = typer.Argument(help="Holds PATTERN/CAMERA.EXT (RAW, DNG or linear OpenEXR)."),
    rig: Path = RigOption,
    out: Path = OutOption,
    subject: str = SubjectOption,
    expression: str = ExpressionOption,
    colour: Path | None = ColourOption,
    as_json: bool = JsonFlag,
) -> None:
    """Make a session of photographs taken elsewhere."""
    the_rig = load_rig(rig)
    calibration = None if colour is None else read_colour(colour, the_rig)
    with progress_bar("import") as progress:
        frames = import_session(folder, the_rig, out, subject, expression, calibration, progress)
    finish(f"{out}: {frames} frames imported", {"session": str(out), "frames": frames}, as_json)


def main() -> None:
    """Entry point of `lightstage`."""
    run_app(app)


if __name__ == "__main__":
    main()
