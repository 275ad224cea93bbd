"""`lightstage import`: photographs taken elsewhere, with a rig or without one."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import typer

from lightstage.capture.config import read_config
from lightstage.commands import JsonFlag, finish, output_folder, progress_bar
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.formats.access import limited_access
from lightstage.formats.cameras import NAME
from lightstage.importing import (
    brightest_pattern,
    find_photographs,
    import_session,
    named_cameras,
)
from lightstage.patterns import split_emitters
from lightstage.poses_from_photos.cameras import FoundCameras, find_cameras
from lightstage.poses_from_photos.lengths import Length, parse_length
from lightstage.poses_from_photos.lenses import read_lenses
from lightstage.poses_from_photos.points import read_clicks
from lightstage.preflight import consent_findings, require_known
from lightstage.rig import Rig, default_rig, load_rig
from lightstage.session import Carried, check_pseudonym, read_calibration, require_new


def register(app: typer.Typer) -> None:
    """Add the command `import` to an application."""
    app.command("import")(import_command)


def import_command(
    folder: Path = typer.Argument(
        help="Holds PATTERN/CAMERA.EXT, or CAMERA.EXT of one light (RAW, DNG, linear OpenEXR; "
        "JPEG, PNG or TIFF at a cost that is reported)."
    ),
    rig: Path | None = typer.Option(
        None, "--rig", help="rig.json: the places of lamps and cameras. Without: see --length."
    ),
    out: Path = output_folder("--out", help="The session's folder, new."),
    subject: str = typer.Option("subject-1", help="Pseudonym of the person, such as P07."),
    expression: str = typer.Option("neutral", help="What the face does."),
    consent: str | None = typer.Option(
        None, help="Id of the record of the person's consent; without it there is a warning."
    ),
    config: Path | None = typer.Option(
        None, help="TOML as of `capture`; its table [session] is used."
    ),
    colour: Path | None = typer.Option(
        None, help="A calibration folder, or a colour calibration alone."
    ),
    landmarks: Path | None = typer.Option(
        None, help="landmarks.json of these photographs; kept in the session."
    ),
    length: list[str] = typer.Option(
        [],
        help="Without --rig: FIRST:SECOND=MM between two cameras' lenses, two points of --points "
        "or two landmarks (0 to 67), such as cam0:cam3=952.6. May be given several times.",
    ),
    points: Path | None = typer.Option(None, help="Without --rig: points.json, clicked points."),
    pattern: str | None = typer.Option(
        None,
        help="Of photographs that are in FOLDER itself: what was lit "
        "[full, where FOLDER has no folders].",
    ),
    front: str | None = typer.Option(
        None,
        help="Without --rig and landmarks: the camera before the face "
        "[the one in the middle of all].",
    ),
    lights: Path | None = typer.Option(
        None, help="Without --rig: rig.json whose lamps are taken [the default rig's]."
    ),
    lenses: Path | None = typer.Option(
        None,
        help="Without --rig: lenses.json, who shares a focal length [by EXIF, else found].",
    ),
    emitters: str | None = typer.Option(
        None, help="With --rig: colours of the emitters that were driven, with commas [all]."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Make a session of photographs taken elsewhere.

    Without --rig, cameras are found from the photographs themselves, and are approximate.
    """
    require_new(out)
    settings = read_config(config).session
    require_known(check_pseudonym(subject, "subject"), settings)
    findings = consent_findings(consent, settings)
    found: FoundCameras | None = None
    if rig is not None:
        given = {
            "--length": length, "--points": points, "--front": front, "--lights": lights,
            "--lenses": lenses,
        }  # fmt: skip
        unused = [name for name, value in given.items() if value]
        if unused:
            raise ConfigError(
                ", ".join(unused), found="together with --rig", expected="one or the other"
            )
        the_rig = load_rig(rig)
    elif emitters is not None:
        raise ConfigError(
            "--emitters", found="without --rig", expected="a rig.json whose lamps have a `colour`"
        )
    else:
        lengths = [parse_length(text) for text in length]
        found = _found(folder, lengths, landmarks, points, front, lights, lenses, pattern)
        the_rig = found.rig
    carried = Carried() if colour is None else read_calibration(colour, the_rig)
    if found is not None:
        data = json.dumps(found.facts, indent=2).encode() + b"\n"
        carried = dataclasses.replace(carried, beside={**carried.beside, NAME: data})
    with limited_access(settings.group), progress_bar("import") as progress:
        imported = import_session(
            folder, the_rig, out, subject, expression, carried, landmarks, progress,
            consent, findings, pattern, () if emitters is None else split_emitters(emitters),
        )  # fmt: skip
    frames = imported.frames
    warnings = [*map(str, (*findings, *imported.findings))]
    warnings += found.warnings if found is not None else ()
    # Only now: who reads them beside an error takes them for its cause.
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    facts: dict[str, Any] = {
        "session": str(out), "frames": frames, "consent": consent, "warnings": warnings,
    }  # fmt: skip
    details = ""
    if found is not None:
        facts |= {"cameras": found.facts}
        details = (
            f"; {counted(len(the_rig.cameras), 'camera')} found from the photographs, approximate: "
            f"{found.facts['residual_px']:.2f} px (mean), {counted(found.facts['points'], 'point')}"
        )
    finish(f"{out}: {counted(frames, 'photograph')} imported{details}", facts, as_json)


def _found(
    folder: Path,
    lengths: list[Length],
    landmarks: Path | None,
    points: Path | None,
    front: str | None,
    lights: Path | None,
    lenses: Path | None,
    pattern: str | None,
) -> FoundCameras:
    stage = default_rig() if lights is None else load_rig(lights)
    photographs = find_photographs(folder, stage, named_cameras(folder, pattern), pattern)
    chosen = brightest_pattern(list(photographs), Rig(stage.lights, ()))
    with progress_bar("cameras") as progress:
        return find_cameras(
            photographs[chosen],
            stage.lights,
            lengths,
            clicks=None if points is None else read_clicks(points),
            landmarks=None if landmarks is None else read_clicks(landmarks),
            front=front,
            lenses=() if lenses is None else read_lenses(lenses),
            progress=progress,
        )
