"""Command `icl`: a server that plays ICL's lsserver until Ctrl-C."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import typer

from lightstage.commands import output_file
from sim.errors import SimError

POLL_S = 0.2


def icl(
    port: int = typer.Option(8080, min=0, max=65535, help="Port to listen on; 0: any free one."),
    host: str = typer.Option("127.0.0.1", help="Address of the network card to listen on."),
    faults: Path | None = typer.Option(None, help="What goes wrong (TOML, docs/faults.md)."),
    out: Path | None = output_file(
        "--out", help="Record of what was lit, as .json.", suffixes=[".json"], default=None
    ),
    picture: Path | None = output_file(
        "--picture", help="Picture of what was lit, as .png.", suffixes=[".png"], default=None
    ),
) -> None:
    """Play ICL's lsserver until Ctrl-C: for `capture --leds ws://..` and for ICL's own client."""
    from lightstage.formats.files import write_json
    from lightstage.formats.png import write_png
    from sim.devices.faults import FaultLog, Story
    from sim.devices.icl_record import drawn, record
    from sim.devices.icl_server import IclServer

    story = Story() if faults is None else Story.read(faults)
    log = FaultLog(None if faults is None else faults.with_suffix(".jsonl").absolute())
    server = IclServer(lambda _: None, port, host, story, log)
    began_s = time.monotonic()
    with server:
        print(f"Ready at {server.url()}; Ctrl-C ends it.")
        if log.path is not None:
            print("What goes wrong is logged in", log.path)
        sys.stdout.flush()
        try:
            while server.failure is None:
                time.sleep(POLL_S)
        except KeyboardInterrupt:
            pass
    if server.failure is not None:
        raise SimError("lsserver", found=str(server.failure)) from server.failure
    if out is not None:
        write_json(out, record(server.states, server.stage.triggers, began_s))
    if picture is not None:
        write_png(picture, drawn(server.states))
