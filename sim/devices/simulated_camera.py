"""A second simulated camera, at the Protocol of lightstage.cameras: all settings, all faults.

``sim.devices.simulated_camera:SimulatedCamera`` in a cameras file is a driver as a product's own
would be: it drains events, takes the RAW of a pair and the file of its own shot, and runs in the
camera's process. What a driver cannot see (a stale or truncated file, a drifted setting) it hands
on.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

from lightstage.cameras.camera import Photograph, Summary
from lightstage.errors import DeviceError
from lightstage.formats.files import write_bytes
from lightstage.rig import Rig
from sim.devices.camera_body import NEXT, BodyError, CameraBody, write_body
from sim.devices.camera_settings import CameraSettings
from sim.devices.faults import FaultLog, Story
from sim.errors import SimError

DRIVER = "sim.devices.simulated_camera:SimulatedCamera"
NO_EVENT_S = 0.2
"""A shot of which nothing is heard for so long, and that is done, has no file."""
POLL_S = 0.1
HINTS = {
    -1: "Try the shot again.",
    -3: "Free its card.",
    -7: "Check its cable and battery, then open it again.",
    -105: "No such camera is connected; check cable and power.",
    -108: "Its card was changed.",
}


class SimulatedCamera:
    """A driver for one simulated body (lightstage.cameras.camera.CameraDriver).

    Args:
        port: the body's folder.
    """

    def __init__(self, port: str) -> None:
        self.port = port
        self._body: CameraBody | None = None

    def open(self) -> Summary:
        """Connect; DeviceError where the camera is gone or off."""
        body = CameraBody(Path(self.port))
        try:
            body.connect()
        except BodyError as error:
            raise self._failure("connect", error) from None
        self._body = body
        settings = body.settings()
        return Summary(
            serial=settings.serial,
            model=settings.model,
            iso=settings.iso,
            shutter=settings.shutter,
            aperture=settings.aperture,
        )

    def settings(self) -> dict[str, Any]:
        """Every setting as it is now, and ``card_free``, the files that its card can still hold."""
        body = self._opened()
        return {**dataclasses.asdict(body.settings()), "card_free": body.card_free()}

    def change(self, name: str, value: Any) -> None:
        """Change a setting; SimError where there is none such."""
        self._opened().change(name, value)

    def capture(self, at_s: float) -> Photograph:
        """Take one photograph and download it; it stays on the card.

        Args:
            at_s: time.monotonic() at which to trigger.

        Raises:
            DeviceError: no picture was taken, or none came.
        """
        body = self._opened()
        time.sleep(max(0.0, at_s - time.monotonic()))
        known = set(body.card())
        triggered_s = time.monotonic()
        try:
            body.trigger()
            own, exposed_s = self._arrived(body, known)
            if not own:
                raise BodyError(-1, "no file came of this shot")
            name = min(own, key=lambda each: (not each.endswith(".DNG"), each))
            data = body.file(name)
        except BodyError as error:
            if error.code == -7:
                self._body = None
            raise self._failure("capture", error) from None
        sha256 = hashlib.sha256(data).hexdigest()
        return Photograph(data, sha256, name, triggered_s, exposed_s, time.monotonic())

    def close(self) -> None:
        """Let go of the camera."""
        self._body = None

    def _arrived(self, body: CameraBody, known: Set[str]) -> tuple[list[str], float]:
        """Names of this shot's files, and when the camera said that the picture was taken.

        A late file of an earlier shot may come too: ours was not on the card before.
        """
        own: list[str] = []
        exposed_s, quiet_s, wanted = -math.inf, 0.0, len(body.settings().suffixes())
        while exposed_s < 0 or (len(own) < wanted and quiet_s < NO_EVENT_S):
            event = body.next_event(POLL_S)
            quiet_s = quiet_s + POLL_S if event is None else 0.0
            if event is not None and event.kind == "done":
                exposed_s = time.monotonic()
            elif event is not None and event.kind == "file" and event.name not in known:
                own.append(event.name)
        return own, exposed_s

    def _opened(self) -> CameraBody:
        if self._body is None:
            raise DeviceError(self.port, found="not open", expected="open() first")
        return self._body

    def _failure(self, doing: str, error: BodyError) -> DeviceError:
        return DeviceError(
            self.port, field=doing, found=f"error {error.code} ({error})", hint=HINTS[error.code]
        )


class SimulatedCameras:
    """A body for each camera of a rig.

    Args:
        root: folder for all of them.
        rig: whose serials and models they have.
        story: what goes wrong.
        log: where that is noted; the cameras' processes know only its file.
        settings: of single cameras, beside serial and model, by name.

    Raises:
        SimError: a fault of a camera that is not in the rig.
    """

    def __init__(
        self,
        root: Path,
        rig: Rig,
        story: Story | None = None,
        log: FaultLog | None = None,
        settings: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.root = root
        self.camera_ids = tuple(camera.id for camera in rig.cameras)
        story = story or Story()
        story.check_cameras(self.camera_ids)
        unknown = [name for name in settings or {} if name not in self.camera_ids]
        if unknown:
            raise SimError(
                "settings", found=repr(unknown[0]), expected=f"one of {', '.join(self.camera_ids)}"
            )
        for camera in rig.cameras:
            own = CameraSettings(camera.serial, camera.model, **(settings or {}).get(camera.id, {}))
            write_body(self.folder(camera.id), camera.id, own, story, log or FaultLog())

    def folder(self, camera_id: str) -> Path:
        """A body's folder, which is its port."""
        return self.root / camera_id

    def put(self, camera_id: str, data: bytes) -> None:
        """Make `data` (a DNG) what the camera's next shot sees; never half of it is seen."""
        write_bytes(self.folder(camera_id) / NEXT, data)

    def cameras_file(self) -> str:
        """The cameras file (TOML) that binds the rig's cameras to these bodies."""
        lines = []
        for camera_id in self.camera_ids:
            # A JSON string is a TOML string too.
            port = json.dumps(str(self.folder(camera_id)), ensure_ascii=False)
            lines += [f"[cameras.{camera_id}]", f'driver = "{DRIVER}"', f"port = {port}"]
        return "\n".join(lines) + "\n"
