"""`lightstage-processing calibrate-cameras`: shots of a ChArUco board to a measured rig.json."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import typer

from lightstage.commands import JsonFlag, finish, output_folder, progress_bar
from lightstage.counting import counted


def register(app: typer.Typer) -> None:
    """Add the command `calibrate-cameras` to an application."""
    app.command("calibrate-cameras")(calibrate_cameras_command)


def calibrate_cameras_command(
    lab: Path = typer.Argument(
        ..., help="A lab's calibration shots, or a session of targets.", show_default=False
    ),
    out: Path = output_folder("--out", help="Folder for rig.json and cameras.json.", shared=True),
    config: Path | None = typer.Option(None, "--config", help="TOML: [board] [cameras]"),
    allow_camera: list[str] = typer.Option([], help="A camera to keep whatever its residual."),
    as_json: bool = JsonFlag,
) -> None:
    """Lens and pose of every camera, from photographs of a ChArUco board."""
    from lightstage.formats.config import read_toml
    from processing.calibration.cameras.output import camera_settings, make_cameras
    from processing.calibration.folder import read_source

    values = {} if config is None else read_toml(config)
    source = read_source(lab)
    settings = camera_settings(source, values, "defaults" if config is None else config)
    allowed = (*settings.cameras.allow, *allow_camera)
    settings = dataclasses.replace(
        settings, cameras=dataclasses.replace(settings.cameras, allow=allowed)
    )
    with progress_bar("boards") as progress:
        found = make_cameras(source, settings, out, progress)
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    measured = found.facts["cameras"].values()
    worst = max(each["residual_px"] for each in measured)
    held = [each["held_out_px"] for each in measured if each["held_out_px"] is not None]
    held_out = f", {max(held):.2f} px at most on boards held out" if held else ""
    count = len(measured) + len(found.unmeasured)
    unchecked = f" ({len(found.unchecked)} unchecked)" if found.unchecked else ""
    finish(
        f"{out}: {len(measured)} of {counted(count, 'camera')} measured{unchecked}, boards within "
        f"{worst:.2f} px (median of the worst){held_out}",
        {
            "out": str(out),
            **found.facts,
            "unmeasured": found.unmeasured,
            "unchecked": found.unchecked,
            "warnings": found.warnings,
        },
        as_json,
    )
