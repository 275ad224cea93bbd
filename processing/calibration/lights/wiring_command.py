"""`lightstage-processing locate-lights`: which lamp is on which wire, into a rig.json."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from lightstage.commands import JsonFlag, finish, output_file, progress_bar
from lightstage.counting import counted


def register(app: typer.Typer) -> None:
    """Add the command `locate-lights` to an application."""
    app.command("locate-lights")(locate_lights_command)


def locate_lights_command(
    lab: Path = typer.Argument(
        ...,
        help="A lab's shots of a mirror ball, taken with --every-light.",
        show_default=False,
    ),
    out: Path = output_file(
        "--out", help="The rig with its lamps' addresses, .json.", suffixes=[".json"], shared=True
    ),
    rig: Path | None = typer.Option(
        None, "--rig", help="rig.json of the same lamps to write them into; the shots' own."
    ),
    allow_unsure: bool = typer.Option(
        False,
        "--allow-unsure",
        help="Give wires that are not sure to the lamps that are left, in order, and warn of it.",
    ),
    config: Path | None = typer.Option(
        None, "--config", help="TOML, as `calibrate`'s: [lights.mirror] is used."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Which lamp each wire lights, from a mirror ball photographed lamp after lamp."""
    from lightstage.formats.config import make_config, read_toml, require_bounds
    from lightstage.rig import load_rig, save_rig
    from processing.bounds import BOUNDS
    from processing.calibration.config import CalibrateConfig
    from processing.calibration.folder import read_source
    from processing.calibration.lights.wiring_shots import locate_lights

    values = {} if config is None else read_toml(config)
    where = "defaults" if config is None else config
    settings = make_config(CalibrateConfig, values, where)
    require_bounds(settings, where, BOUNDS)
    own = None if rig is None else load_rig(rig)
    source = read_source(lab)
    with progress_bar("mirror ball") as progress:
        found = locate_lights(source, own, settings.lights.mirror, allow_unsure, progress)
    save_rig(found.rig, out)
    for warning in found.unsure:
        print(f"warning: {warning}", file=sys.stderr)
    left = f", {len(found.unsure)} not sure" if found.unsure else ""
    finish(
        f"{out}: {found.sure} of {counted(len(found.rig.lights), 'lamp')} found{left}, "
        f"{counted(found.moved, 'address', 'addresses')} changed, highlights within "
        f"{found.worst_mm:.2f} mm on the ball",
        {
            "out": str(out),
            "lights": len(found.rig.lights),
            "found": found.sure,
            "changed": found.moved,
            "unsure": found.unsure,
            "worst_mm": round(found.worst_mm, 4),
        },
        as_json,
    )
