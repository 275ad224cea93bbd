"""The command `devices`: what is on the stage, and what would keep a capture from starting."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import typer

from lightstage.cameras.binding import CamerasFile, read_cameras_file
from lightstage.capture.config import read_config
from lightstage.capture.devices import CameraLook, look_at_devices
from lightstage.commands import JsonFlag, finish
from lightstage.commands.tables import print_table
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.leds.address import LEDS_HELP
from lightstage.operator.words import notice_of
from lightstage.preflight import Plan
from lightstage.rig import load_rig

TITLES = ("camera", "serial", "port", "lens", "battery", "free shots", "differs")
PHOTOGRAPHS = 12
"""Photographs of each camera that must fit on card and disk: a binary sequence with a few retakes.
"""


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("devices")(devices_command)


def devices_command(
    rig: Path = typer.Option(..., help="rig.json: the places of lamps and cameras."),
    leds: str = typer.Option(..., help=LEDS_HELP),
    cameras: str = typer.Option("auto", help="A cameras file (TOML), or auto: by serial number."),
    folder: Path = typer.Option(
        Path(),
        help="Where sessions will be: its disk and the clocks of its journals are checked.",
    ),
    config: Path | None = typer.Option(None, help="TOML with other values than the defaults."),
    as_json: bool = JsonFlag,
) -> None:
    """Check lights and cameras as a capture does before its first light; nothing is lit."""
    if not folder.is_dir():
        found = "a file" if folder.exists() else "no such folder"
        raise ConfigError(folder, field="--folder", found=found, expected="a folder of sessions")
    settings = read_config(config)
    the_rig = load_rig(rig)
    file = CamerasFile() if cameras == "auto" else read_cameras_file(Path(cameras))
    look = look_at_devices(the_rig, leds, file, settings, folder / "session", Plan(PHOTOGRAPHS))
    if not as_json:
        print_table(TITLES, map(_cells, look.cameras))
        for finding in look.findings:
            print(notice_of({"event": "finding", **dataclasses.asdict(finding)}), file=sys.stderr)
    answering = sum(each.answers for each in look.cameras)
    wrong = sum(each.severity == "refuse" for each in look.findings)
    ready = "ready" if look.ready else f"not ready: {counted(wrong, 'thing')} to mend"
    lights = "no answer from the lights"
    if look.lights is not None:
        lights = f"{counted(look.lights.light_count, 'lamp')} answer"
    finish(
        f"{lights}, {answering} of {counted(len(look.cameras), 'camera')} answer, {ready}",
        look.facts(),
        as_json,
    )


def _cells(camera: CameraLook) -> list[str]:
    if not camera.answers:
        return [camera.id, camera.serial, camera.port or "-", "NO ANSWER", "-", "-", "-"]
    battery = "-" if camera.battery_percent is None else f"{camera.battery_percent:.0f} %"
    shots = "-" if camera.free_shots is None else str(camera.free_shots)
    differs = ", ".join(f"{name} {camera.settings.get(name, '')}" for name in camera.differing)
    return [
        camera.id,
        camera.serial,
        camera.port,
        camera.lens or "-",
        battery,
        shots,
        differs or "-",
    ]
