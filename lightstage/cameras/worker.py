"""A camera's own process: reads commands on stdin, answers on stdout, ends with its parent.

``python -m lightstage.cameras.worker CAMERA HANDLE``, started by lightstage.cameras.child.
Photographs go from here to the disk; answers are short.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from lightstage import steps
from lightstage.cameras import messages
from lightstage.cameras.camera import CameraDriver
from lightstage.cameras.card_file import SHOT
from lightstage.cameras.gphoto import GphotoCamera
from lightstage.cameras.gphoto_link import Patience
from lightstage.cameras.lifeline import end_with
from lightstage.errors import CaptureError, DeviceError, LightstageError


def serve(camera_id: str, commands: BinaryIO, replies: BinaryIO) -> None:
    """Answer commands until their stream ends; errors are answers too."""
    serving = _Serving(camera_id)
    while (request := messages.read(commands.read)) is not None:
        try:
            reply = serving.answer(request)
        except LightstageError as error:
            reply = {"error": _error_fields(error)}
        replies.write(messages.pack(reply))
        replies.flush()
    if serving.camera is not None:
        serving.camera.close()


class _Serving:
    """One camera's driver and what it is asked."""

    def __init__(self, camera_id: str) -> None:
        self.camera_id = camera_id
        self.camera: CameraDriver | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """The answer to one command, ready for JSON."""
        command = request["command"]
        if command == "ports":
            return {"ports": _ports(request)}
        if command == "open":
            self.camera = _driver(request)
            return dataclasses.asdict(self.camera.open())
        if self.camera is None:
            raise DeviceError(self.camera_id, field=command, found="not open", expected="open()")
        SHOT.set((request.get("pattern", "*"), self.camera_id))
        does: dict[str, Callable[[CameraDriver, dict[str, Any]], dict[str, Any]]] = {
            "summary": lambda camera, _: dataclasses.asdict(camera.summary()),
            "change": _change,
            "card": lambda camera, _: {"files": [[f.name, f.size] for f in camera.card()]},
            "trigger": _trigger,
            "download": _download,
            "delete": _delete,
        }
        return does[command](self.camera, request)


def _trigger(camera: CameraDriver, request: dict[str, Any]) -> dict[str, Any]:
    steps.step("triggering", *SHOT.get())
    exposure = camera.trigger(request["at_s"])
    steps.step("triggered", *SHOT.get())
    return {
        "files": [[file.name, file.size] for file in exposure.files],
        "triggered_s": exposure.triggered_s,
        "exposed_s": exposure.exposed_s,
    }


def _download(camera: CameraDriver, request: dict[str, Any]) -> dict[str, Any]:
    got = camera.download(request["name"], Path(request["path"]))
    steps.step("downloaded", *SHOT.get())
    return dataclasses.asdict(got)


def _change(camera: CameraDriver, request: dict[str, Any]) -> dict[str, Any]:
    camera.change(request["name"], request["value"])
    return {}


def _delete(camera: CameraDriver, request: dict[str, Any]) -> dict[str, Any]:
    camera.delete(request["name"])
    return {}


def _class(request: dict[str, Any]) -> Callable[..., CameraDriver]:
    """libgphoto2's driver, or the one that is named; DeviceError where there is none such."""
    named = request["driver"]
    if named is None:
        return GphotoCamera
    module, _, name = named.partition(":")
    try:
        made: Callable[..., CameraDriver] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise DeviceError(
            request["port"],
            field="driver",
            found=str(error),
            expected=f"an installed module {module} with {name}",
        ) from None
    return made


def _driver(request: dict[str, Any]) -> CameraDriver:
    if request["driver"] is not None:
        return _class(request)(request["port"])
    folder = request["virtual_folder"]
    patience = Patience() if request["patient"] else Patience(claimed_tries=1)
    return GphotoCamera(request["port"], Path(folder) if folder else None, patience)


def _ports(request: dict[str, Any]) -> list[list[str]]:
    """Model and port of what is connected now.

    A driver may have a static method ``ports(given)`` that lists them for the port that it was
    given; one without can be only where it was.
    """
    find = getattr(_class(request), "ports", None)
    if find is None:
        return [["", request["port"]]]
    return [[str(model), str(port)] for model, port in find(request["port"])]


def _error_fields(error: LightstageError) -> dict[str, str]:
    """An error's parts, so that the parent can report them with the camera's name."""
    return {
        "kind": "disk" if isinstance(error, CaptureError) else "camera",
        "where": error.where,
        "field": error.field,
        "found": error.found,
        "expected": error.expected,
        "hint": error.hint,
    }


def main() -> None:
    """Serve; what C libraries print goes to stderr, never among the replies."""
    camera_id, handle = sys.argv[1:]
    end_with(int(handle))
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(camera_id, sys.stdin.buffer, replies)


if __name__ == "__main__":
    main()
