"""`lightstage-processing calibrate`: calibration photographs to what sessions are measured by."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from lightstage.commands import JsonFlag, finish, output_folder, progress_bar


def register(app: typer.Typer) -> None:
    """Add the command `calibrate` to an application."""
    app.command("calibrate")(calibrate_command)


def calibrate_command(
    lab: Path = typer.Argument(
        ..., help="A lab's calibration shots, or a session of targets.", show_default=False
    ),
    out: Path = output_folder("--out", help="Calibration folder, made or replaced.", shared=True),
    config: Path | None = typer.Option(None, "--config", help="TOML: [chart] [colour] [flat] .."),
    as_json: bool = JsonFlag,
) -> None:
    """Colours, flats and black level of every camera, and lamps, from photographed targets."""
    from lightstage.formats.config import make_config, read_toml, require_bounds
    from processing.bounds import BOUNDS
    from processing.calibration.config import CalibrateConfig
    from processing.calibration.folder import read_source
    from processing.calibration.output import headline, make_calibration

    values = {} if config is None else read_toml(config)
    where = "defaults" if config is None else config
    settings = make_config(CalibrateConfig, values, where)
    require_bounds(settings, where, BOUNDS)
    source = read_source(lab)
    with progress_bar("calibrate") as progress:
        found = make_calibration(source, settings, out, progress)
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    facts = {"out": str(out), **found.facts, "warnings": found.warnings}
    finish(f"{out}: {headline(found)}", facts, as_json)
