"""The commands `calibrate` and `calibrations`."""

from __future__ import annotations

import dataclasses
import datetime
import sys
from pathlib import Path

import typer

from lightstage.calibrations.assistant import TerminalAssistant, UnattendedAssistant
from lightstage.calibrations.config import KIND_NAMES, require_kind
from lightstage.calibrations.kinds import kind_of
from lightstage.calibrations.listing import list_lab, rigs_of
from lightstage.calibrations.run import Assistant, begin_shots, resume_shots, take_poses
from lightstage.calibrations.stale import duration
from lightstage.calibrations.taking import SessionTaker
from lightstage.cameras.binding import CamerasFile, read_cameras_file
from lightstage.capture.command import IgnoreClock, resume_with
from lightstage.capture.config import read_config
from lightstage.capture.shot import stopped
from lightstage.capture.stage import open_stage
from lightstage.commands import JsonFlag, finish, output_folder
from lightstage.counting import counted
from lightstage.errors import ConfigError, LightstageError
from lightstage.leds.address import worst_answer_s
from lightstage.operator import Unattended
from lightstage.resume_line import calibrate_line, shell_line
from lightstage.rig import load_rig
from lightstage.safety import check_shots
from lightstage.sequence import plan_shots

ConfigOption = typer.Option(None, "--config", help="TOML with values that differ from defaults.")


def register(app: typer.Typer) -> None:
    """Add the commands to an application."""
    app.command("calibrate")(calibrate_command)
    app.command("calibrations")(calibrations_command)


def calibrate_command(
    kind: str = typer.Argument(help=f"What is photographed: {', '.join(KIND_NAMES)}."),
    rig: Path = typer.Option(..., "--rig", help="rig.json: the places of lamps and cameras."),
    out: Path = output_folder("--out", help="The lab's folder of calibration shots.", shared=True),
    leds: str = typer.Option(..., help="The LED device, as for `capture`."),
    cameras: str = typer.Option("auto", help="A cameras file (TOML), or auto: by serial number."),
    resume: bool = typer.Option(
        False, "--resume", help="Resume the newest unfinished shots of this kind."
    ),
    poses: int | None = typer.Option(None, min=1, help="How many, in place of the kind's own."),
    unattended: float | None = typer.Option(
        None, min=0.0, help="Ask nobody: so many seconds before each pose to change the target."
    ),
    ignore_clock: IgnoreClock = False,
    every_light: bool = typer.Option(
        False, "--every-light", help="Of a mirror ball: lamp after lamp, not gradients."
    ),
    config: Path | None = ConfigOption,
    as_json: bool = JsonFlag,
) -> None:
    """Take calibration shots pose by pose; each is checked before the next."""
    chosen = kind_of(kind)
    settings = read_config(config, ignore_clock=ignore_clock)
    _require_meaning(kind, resume, poses, every_light)
    the_rig = load_rig(rig)
    planned = plan_shots(chosen.shown(the_rig, every_light), the_rig, chosen.drive)
    worst_s = settings.worst_shot_s(worst_answer_s(leds))
    check_shots(planned, the_rig, settings.safety, worst_s)
    file = CamerasFile() if cameras == "auto" else read_cameras_file(Path(cameras))
    assistant: Assistant = TerminalAssistant(_print_line, _ask)
    if unattended is not None:
        assistant = UnattendedAssistant(
            _print_line, unattended, settings.calibration.retakes_per_pose
        )
    with open_stage(the_rig, leds, file, settings) as stage:
        hello, own = stage.lights.hello, settings.calibration
        if resume:
            shots = resume_shots(chosen, out, the_rig, stage.summaries, hello)
        else:
            now = datetime.datetime.now(datetime.UTC)
            shots = begin_shots(
                chosen, out, the_rig, stage.summaries, hello, own, now, poses, every_light
            )
        taker = SessionTaker(stage, chosen, settings, Unattended(settings.operator))
        try:
            report = take_poses(chosen, shots, the_rig, taker, assistant, own, _poses_done)
        except (LightstageError, KeyboardInterrupt) as error:
            flags = {
                f"--unattended={unattended}": unattended is not None,
                "--ignore-clock": ignore_clock,
            }
            options = resume_with(leds, cameras, config, flags)
            line = calibrate_line(kind, rig.absolute(), out.absolute(), options)
            ended = stopped() if isinstance(error, KeyboardInterrupt) else error
            raise type(ended)(f"{ended}\n  To resume: {line}") from None
    held = (shots.file.expires - shots.file.created).total_seconds() / 86400
    finish(
        f"{shots.root}: {counted(report.poses, 'pose')}, {report.again} retaken, "
        f"{counted(report.warnings, 'fault')} accepted, holds {duration(held)}; "
        f"what is still missing: {shell_line('lightstage', 'calibrations', str(out))}",
        {
            "shots": str(shots.root),
            "id": shots.file.id,
            "kind": kind,
            "poses": report.poses,
            "now": report.now,
            "again": report.again,
            "accepted": report.warnings,
            "expires_utc": shots.file.expires_utc,
        },
        as_json,
    )


def calibrations_command(
    lab: Path = typer.Argument(help="The lab's folder of calibration shots."),
    config: Path | None = ConfigOption,
    as_json: bool = JsonFlag,
) -> None:
    """List a lab's calibration shots with their age, and how long they still hold."""
    settings = read_config(config)
    now = datetime.datetime.now(datetime.UTC)
    entries, damaged = list_lab(lab, now, settings.calibration)
    if not as_json:
        for entry in entries:
            print(f"{entry.kind:8} {entry.folder or '-':26} {entry.says}")
    for problem in damaged:
        print(f"cannot be read: {problem}", file=sys.stderr)
    holding = sum(entry.state == "holds" for entry in entries)
    rigs = rigs_of(entries)
    finish(
        f"{lab}: {holding} of {len(KIND_NAMES)} kinds hold, "
        f"{counted(len(damaged), 'file')} damaged" + (f"; {rigs}" if rigs else ""),
        {
            "lab": str(lab),
            "holds": holding,
            "shots": [dataclasses.asdict(entry) for entry in entries],
            "damaged": damaged,
        },
        as_json,
    )


def _require_meaning(kind: str, resume: bool, poses: int | None, every_light: bool) -> None:
    """ConfigError for options that would do nothing."""
    require_kind(kind, "kind")
    if every_light and kind != "mirror":
        raise ConfigError("--every-light", found=f"of {kind}", expected="a mirror ball alone")
    if resume and (poses is not None or every_light):
        raise ConfigError(
            "--resume",
            found="--poses" if poses is not None else "--every-light",
            expected="neither: the shots that are resumed have theirs",
        )


def _poses_done(done: int, count: int) -> None:
    if done:
        _print_line(f"  {done} of {counted(count, 'pose')} done.")


def _print_line(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _ask(question: str) -> str:
    print(question, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline()
    if not line:
        raise EOFError
    return line
