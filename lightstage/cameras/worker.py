"""A camera's own process: reads commands on stdin, answers on stdout, ends with its parent.

``python -m lightstage.cameras.worker``, started by lightstage.cameras.process.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import sys
from pathlib import Path
from typing import Any, BinaryIO

from lightstage.cameras import messages
from lightstage.cameras.camera import CameraDriver
from lightstage.cameras.gphoto import GphotoCamera, detect
from lightstage.errors import DeviceError, LightstageError


def serve(commands: BinaryIO, replies: BinaryIO) -> None:
    """Answer commands until their stream ends; errors are answers too."""
    camera: CameraDriver | None = None
    while (message := messages.read(commands.read)) is not None:
        asked, _ = message
        data = b""
        reply: dict[str, Any] = {}
        try:
            if asked["command"] == "detect":
                reply = {"found": detect()}
            elif asked["command"] == "open":
                camera = _driver(asked)
                reply = dataclasses.asdict(camera.open())
            elif asked["command"] == "capture" and camera is not None:
                photograph = camera.capture(asked["at_s"])
                reply, data = dataclasses.asdict(photograph), photograph.data
                del reply["data"]
        except LightstageError as error:
            reply = {"error": dataclasses.asdict(_Told.of(error))}
        replies.write(messages.head(reply, len(data)))
        replies.write(data)
        replies.flush()
    if camera is not None:
        camera.close()


def _driver(asked: dict[str, Any]) -> CameraDriver:
    """libgphoto2's driver, or the one that is named; DeviceError where there is none such."""
    named, folder = asked["driver"], asked["virtual_folder"]
    if named is None:
        return GphotoCamera(asked["port"], Path(folder) if folder else None)
    module, _, name = named.partition(":")
    try:
        camera: CameraDriver = getattr(importlib.import_module(module), name)(asked["port"])
    except (ImportError, AttributeError) as error:
        raise DeviceError(
            asked["port"],
            field="driver",
            found=str(error),
            expected=f"an installed module {module} with {name}",
        ) from None
    return camera


@dataclasses.dataclass(frozen=True)
class _Told:
    """An error's parts, so that the parent can say them with the camera's name."""

    where: str
    field: str
    found: str
    expected: str
    hint: str

    @staticmethod
    def of(error: LightstageError) -> _Told:
        return _Told(error.where, error.field, error.found, error.expected, error.hint)


def main() -> None:
    """Serve; what C libraries print goes to stderr, never among the replies."""
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(sys.stdin.buffer, replies)


if __name__ == "__main__":
    main()
