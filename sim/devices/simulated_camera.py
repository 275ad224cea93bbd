"""A second simulated camera, at the Protocol of lightstage.cameras: all settings, all faults.

``sim.devices.simulated_camera:SimulatedCamera`` in a cameras file is a driver as a product's own
would be: it drains events, takes the RAW of a pair and the file of its own shot, and runs in the
camera's process. What a driver cannot see (a stale or truncated file, a drifted setting) it hands
on.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from lightstage.cameras.camera import (
    FREE_CARD,
    VERIFIABLE,
    CardFile,
    Download,
    Exposure,
    Summary,
)
from lightstage.cameras.card_file import pieces, write_card_file
from lightstage.errors import DeviceError
from lightstage.formats.files import write_bytes
from sim.devices.body_folder import NEXT, write_body
from sim.devices.camera_body import BodyError, CameraBody
from sim.devices.camera_settings import CameraSettings
from sim.devices.faults import FaultLog, Story
from sim.errors import SimError

if TYPE_CHECKING:
    from lightstage.rig import Rig

T = TypeVar("T")
DRIVER = "sim.devices.simulated_camera:SimulatedCamera"
FOLDER = "/DCIM/100SIM/"
"""Where its files are on the card, as it reports."""
NO_EVENT_S = 0.2
"""A shot of which nothing is heard for so long, and that is done, has no file."""
POLL_S = 0.1
PATIENCE_S = 3.0
"""So long it is asked again while it is busy, or another program's."""
HINTS = {
    -1: "Try the shot again.",
    -3: FREE_CARD,
    -7: "Check its cable and battery.",
    -53: "Another program has the camera: close it.",
    -105: "No such camera is connected; check cable and power.",
    -108: "Its card was changed.",
    -110: "Wait until it has written its pictures.",
}


class SimulatedCamera:
    """A driver for one simulated body (lightstage.cameras.camera.CameraDriver).

    Args:
        port: the body's folder, or a link to it.
    """

    def __init__(self, port: str) -> None:
        self.port = port
        self._body: CameraBody | None = None

    @staticmethod
    def ports(given: str) -> list[tuple[str, str]]:
        """Model and port of every body beside the given one that is on the bus now."""
        found = []
        for path in sorted(Path(given).parent.iterdir()):
            if (path / "camera.json").is_file():
                body = CameraBody(path)
                if body.plugged() == path.name:
                    found.append((body.settings().model, str(path)))
        return found

    def open(self) -> Summary:
        """Connect; DeviceError where the camera is absent or off."""
        if not Path(self.port).exists():
            raise DeviceError(self.port, field="connect", found="nothing", hint=HINTS[-105])
        body = CameraBody(Path(self.port))
        self._again("connect", body.connect)
        self._body = body
        return self.summary()

    def summary(self) -> Summary:
        """Every setting as it is now."""
        return self._again("summary", self._summary)

    def change(self, name: str, value: str) -> None:
        """Change a setting; DeviceError where there is none such, or no such value."""
        try:
            self._opened().change(name, value)
        except SimError as error:
            raise DeviceError(
                self.port, field=name, found=error.found, expected=error.expected
            ) from None

    def card(self) -> tuple[CardFile, ...]:
        """Every file on the card, oldest first."""

        def files() -> tuple[CardFile, ...]:
            body = self._opened()
            return tuple(CardFile(FOLDER + name, body.size(name)) for name in body.card())

        return self._again("card", files)

    def trigger(self, at_s: float) -> Exposure:
        """Take one photograph; it stays on the card.

        Args:
            at_s: time.monotonic() at which to trigger.

        Raises:
            DeviceError: no picture was taken, none came, or nobody knows.
        """
        body = self._opened()
        known = set(self._again("card", body.card))
        time.sleep(max(0.0, at_s - time.monotonic()))
        triggered_s = time.monotonic()
        self._again("trigger", body.trigger, repeatable=False)
        own, exposed_s = self._arrived(body, known)
        if not own:
            raise self._failure("trigger", BodyError(-1, "no file came of this shot"))
        names = sorted(own, key=lambda each: (not each.endswith(".DNG"), each))
        files = tuple(CardFile(FOLDER + name, body.size(name)) for name in names)
        return Exposure(files, triggered_s, exposed_s)

    def download(self, name: str, path: Path) -> Download:
        """Write a file of the card to a new file; a part of it where no more came."""
        own = name.removeprefix(FOLDER)
        size = self._again("download", lambda: self._opened().size(own))
        data = self._again("download", lambda: self._opened().file(own))
        return write_card_file(path, size, pieces(memoryview(data)))

    def delete(self, name: str) -> None:
        """Remove a file from the card."""
        self._again("delete", lambda: self._opened().delete(name.removeprefix(FOLDER)))

    def close(self) -> None:
        """Let go of the camera."""
        self._body = None

    def _summary(self) -> Summary:
        body = self._opened()
        settings = dataclasses.asdict(body.settings())
        known = {name: settings[name] for name in (*VERIFIABLE, "lens") if name in settings}
        return Summary(**known, card_free_bytes=body.card_free_bytes())

    def _arrived(self, body: CameraBody, known: Set[str]) -> tuple[list[str], float]:
        """Names of this shot's files, and when the camera reported that the picture was taken.

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

    def _again(self, doing: str, call: Callable[[], T], repeatable: bool = True) -> T:
        """Ask the body; again while it is busy or claimed, once more after its connection ended."""
        until = time.monotonic() + PATIENCE_S
        reconnected = False
        while True:
            try:
                return call()
            except BodyError as error:
                if error.code in (-53, -110) and time.monotonic() < until:
                    time.sleep(POLL_S)
                elif error.code == -7 and repeatable and not reconnected and self._body:
                    reconnected = True
                    self._again("connect", self._body.connect)
                else:
                    if error.code == -7:
                        self._body = None
                    raise self._failure(doing, error) from None

    def _opened(self) -> CameraBody:
        if self._body is None:
            raise DeviceError(self.port, found="not open", expected="open() first")
        return self._body

    def _failure(self, doing: str, error: BodyError) -> DeviceError:
        hint = error.hint or HINTS[error.code]
        found = f"error {error.code} ({error})"
        return DeviceError(self.port, field=doing, found=found, hint=hint)


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
