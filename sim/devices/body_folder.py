"""The folder of a simulated camera's body: all that it remembers.

    camera.json   who it is, its settings, its part of the story
    next.dng      what a shot gives now; replaced when the light changes
    state.json    shots so far, what is pending, where it is plugged in, whether it is absent or off
    card/         its files, DSC_0001.DNG and so on

A port is a path to that folder: its own, or a link beside it after it was plugged in elsewhere.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from lightstage.formats.files import write_json
from sim.devices.camera_settings import CameraSettings
from sim.devices.faults import FaultLog, Story

SCHEMA = "lightstage.simulated_camera/1"
NEXT = "next.dng"


def put(path: Path, data: bytes) -> None:
    """Write a file that is never seen half; it outlives its process, which is all that is asked."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    beside.write_bytes(data)
    os.replace(beside, path)


def write_body(
    folder: Path,
    camera_id: str,
    settings: CameraSettings,
    story: Story,
    log: FaultLog,
) -> Path:
    """Make a new camera's folder, with an empty card and nothing before its lens.

    Args:
        folder: that is not there yet.
        camera_id: its name in the story.
        settings: as it is switched on.
        story: what goes wrong; other devices' faults may be in it.
        log: whose file is written to.
    """
    (folder / "card").mkdir(parents=True)
    write_json(
        folder / "camera.json",
        {
            "schema": SCHEMA,
            "id": camera_id,
            "settings": dataclasses.asdict(settings),
            "story": story.as_dict(),
            "log": None if log.path is None else str(log.path),
        },
    )
    state = {
        "shots": 0,
        "opens": 0,
        "changed": {},
        "pending": [],
        "trouble": {},
        "plug": folder.name,
        "gone_until_s": 0.0,
        "claimed_until_s": 0.0,
        "busy_until_s": 0.0,
        "busy_at": 0,
        "off": False,
    }
    write_json(folder / "state.json", state)
    return folder
