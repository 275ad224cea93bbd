"""`lightstage rig check`: a rig read, drawn, and checked for oddities."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import typer

from lightstage.commands import JsonFlag, finish, make_app, output_file
from lightstage.counting import counted
from lightstage.formats.png import write_png
from lightstage.rig import load_rig
from lightstage.rig_oddities import rig_oddities
from lightstage.rig_picture import draw_rig


def register(app: typer.Typer) -> None:
    """Add the group `rig` to an application."""
    group = make_app("The description of the stage: the places of its lamps and cameras.")
    group.command("check")(check_command)
    app.add_typer(group, name="rig")


def check_command(
    rig: Path = typer.Argument(help="rig.json."),
    out: Path | None = output_file(
        "--out", help="Picture of it, .png.", suffixes=[".png"], default=None, shared=True
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Read a rig, refuse what cannot be used, warn of what is odd, and draw it."""
    the_rig = load_rig(rig)
    found = rig_oddities(the_rig)
    channels: dict[str, list[int]] = {}
    for address in the_rig.addresses:
        channels.setdefault(address.controller, []).append(address.channel)
    if out is not None:
        write_png(out, draw_rig(the_rig))
    for finding in found:
        print(f"warning: {finding}", file=sys.stderr)
    ranges = {name: [min(each), max(each)] for name, each in channels.items()}
    wires = [
        f"channels {low} to {high}{f' of {name}' if len(ranges) > 1 else ''}"
        for name, (low, high) in ranges.items()
    ]
    wired = f" on {', '.join(wires)}" if the_rig.addressed else ""
    drawn = "" if out is None else f", drawn in {out}"
    odd = counted(len(found), "odd thing") if found else "nothing odd"
    finish(
        f"{rig}: {counted(len(the_rig.lights), 'lamp')}{wired}, "
        f"{counted(len(the_rig.cameras), 'camera')}, {odd}{drawn}",
        {
            "rig": str(rig),
            "lights": len(the_rig.lights),
            "cameras": len(the_rig.cameras),
            "addressed": the_rig.addressed,
            "channels": ranges,
            "odd": [dataclasses.asdict(finding) for finding in found],
            "picture": None if out is None else str(out),
        },
        as_json,
    )
