"""The command `console`: the operator's page on this computer."""

from __future__ import annotations

import contextlib
import secrets
import time
from pathlib import Path

import typer

from lightstage.cameras.cameras_file import read_cameras_file
from lightstage.capture.config import read_config
from lightstage.commands import JsonFlag, finish, output_file
from lightstage.console.access import TOKEN
from lightstage.console.app import guarded
from lightstage.console.config import ConsoleConfig
from lightstage.console.desk import Desk, StageOptions
from lightstage.console.runner import FOLDER
from lightstage.console.server import LOOPBACK, listen, local_address, serving
from lightstage.errors import CaptureError, ConfigError, FormatError
from lightstage.formats.lock import locked
from lightstage.leds.opening import require_controllers
from lightstage.rig import load_rig
from lightstage.session import read_calibration

POLL_S = 0.2
LEAST_PORT, MOST_PORT = 1024, 65535


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("console")(console_command)


def console_command(
    plan: Path = output_file(
        "--plan", help="The day's plan (TOML); made when somebody adds to it.", suffixes=[".toml"]
    ),
    rig: Path | None = typer.Option(None, help="rig.json: the places of lamps and cameras."),
    leds: str | None = typer.Option(
        None, help="The LED device, as for `capture`; without it nothing is captured."
    ),
    cameras: str = typer.Option("auto", help="A cameras file (TOML), or auto: by serial number."),
    config: Path | None = typer.Option(
        None, help="TOML with other values than the defaults, as for `capture`."
    ),
    calibration: Path | None = typer.Option(
        None, help="The lab's folder of calibration shots, as for `capture`."
    ),
    colour: Path | None = typer.Option(None, help="A colour calibration, as for `capture`."),
    processed: Path | None = typer.Option(
        None, help="Folder of processed folders, whose reports open from the page."
    ),
    port: int = typer.Option(
        ConsoleConfig().port, help="Port of this computer, 1024 or more; 0 takes a free one."
    ),
    allow_from: str | None = typer.Option(
        None,
        help="Address of one other computer that may see the page and press its keys. Opens a port "
        "to that network without encryption: whoever records it sees photographs and the token.",
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Serve the operator's page on 127.0.0.1 until Ctrl-C; captures continue without it."""
    stage = _stage(rig, leds, cameras, config, calibration, colour)
    if port and not LEAST_PORT <= port <= MOST_PORT:
        expected = f"0, or from {LEAST_PORT} to {MOST_PORT}"
        raise ConfigError("--port", found=str(port), expected=expected)
    if processed is not None and not processed.is_dir():
        raise FormatError(processed, field="--processed", expected="a folder of processed folders")
    outside = None if allow_from is None else local_address(allow_from)
    desk = Desk(plan, stage, processed, ConsoleConfig(port=port))
    busy = CaptureError(
        plan,
        found="another console that has it",
        expected="one console of a plan",
        hint="Use the page of that one, or end it first.",
    )
    addresses = [LOOPBACK, *([outside] if outside else [])]
    with contextlib.ExitStack() as stack:
        stack.enter_context(locked(desk.folder / FOLDER / "console.lock", busy))
        sockets = listen(addresses, port)
        served = int(sockets[0].getsockname()[1])
        token = secrets.token_urlsafe(32)
        hosts = [f"{name}:{served}" for name in (*addresses, "localhost")]
        clients = [] if allow_from is None else [allow_from]
        stack.callback(desk.album.close)
        desk.album.start()
        thread = stack.enter_context(
            serving(guarded(desk, token, hosts, clients), sockets, desk.closing)
        )
        urls = [f"http://{address}:{served}/?{TOKEN}={token}" for address in addresses]
        print(f"Open {urls[0]}\nCtrl-C ends the page; a capture that runs continues.", flush=True)
        if outside is not None:
            print(
                f"From {allow_from} open {urls[1]}\nThat connection is not encrypted: whoever "
                "records it sees the photographs, and the token that lets them press keys.",
                flush=True,
            )
        try:
            while thread.is_alive():
                time.sleep(POLL_S)
        except KeyboardInterrupt:
            pass
    running = desk.running()
    on = f"; the capture of {running} continues" if running else ""
    finish(f"{plan}: page closed{on}", {"plan": str(plan), "running": running or None}, as_json)


def _stage(
    rig: Path | None,
    leds: str | None,
    cameras: str,
    config: Path | None,
    calibration: Path | None,
    colour: Path | None,
) -> StageOptions | None:
    """The options that captures are started with, checked before the page is served."""
    if rig is None or leds is None:
        given = {
            "--rig": rig,
            "--leds": leds,
            "--config": config,
            "--calibration": calibration,
            "--colour": colour,
        }
        alone = [name for name, value in given.items() if value is not None]
        if alone or cameras != "auto":
            raise ConfigError(
                ", ".join(alone or ["--cameras"]),
                found="no --rig" if rig is None else "no --leds",
                expected="both, or a page without a stage",
            )
        return None

    the_rig = load_rig(rig)
    require_controllers(leds, the_rig)
    read_config(config)
    if colour is not None:
        read_calibration(colour, the_rig)
    if calibration is not None and not calibration.is_dir():
        found = "a file" if calibration.exists() else "no such folder"
        expected = "the lab's folder of calibration shots"
        raise ConfigError(calibration, field="--calibration", found=found, expected=expected)
    file = cameras
    if cameras != "auto":
        read_cameras_file(Path(cameras))
        file = str(Path(cameras).absolute())

    def whole(path: Path | None) -> Path | None:
        return None if path is None else path.absolute()

    return StageOptions(
        rig.absolute(), leds, file, whole(config), whole(calibration), whole(colour)
    )
