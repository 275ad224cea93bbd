"""Cameras through libgphoto2. The only file with gphoto2; it runs in a camera's own process."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lightstage.cameras.camera import Photograph, Summary
from lightstage.errors import DeviceError

HINTS = {
    -1: "Is there free space, and is the lens able to focus?",
    -3: "The camera's memory is full; free its card, then switch it off and on.",
    -7: "Switch the camera off and on, or plug its cable in again.",
    -53: "Another program has the camera: stop the desktop's photo import (gvfs).",
    -105: "No such camera is connected; check cable and power.",
    -110: "The camera is busy; wait until it has written its pictures.",
}
"""What to try, by libgphoto2's error code."""

# Names under which makers offer the same setting, most common first.
SETTINGS = {
    "iso": ("iso", "isospeed"),
    "shutter": ("shutterspeed", "shutterspeed2"),
    "aperture": ("f-number", "aperture"),
}


def _library(virtual_folder: Path | None) -> Any:
    """Import gphoto2; its virtual camera is chosen by the environment before the import."""
    if virtual_folder is not None:
        os.environ["VCAMERADIR"] = str(virtual_folder)
    import gphoto2

    if "VCAMERADIR" in os.environ:
        head, tail = os.path.split(os.environ.get("IOLIBS", ""))
        if tail == "iolibs":
            os.environ["IOLIBS"] = os.path.join(head, "vusb")
    return gphoto2


def detect() -> list[tuple[str, str]]:
    """Model and port of every camera that is connected."""
    gphoto2 = _library(None)
    found = gphoto2.Camera.autodetect()
    return [(found.get_name(index), found.get_value(index)) for index in range(found.count())]


class GphotoCamera:
    """One camera at a port, or libgphoto2's virtual camera on a folder.

    Args:
        port: such as ``usb:001,004``.
        virtual_folder: holds ``DCIM/100TEST/<seed>.jpg``, whose bytes every capture gives.
    """

    def __init__(self, port: str, virtual_folder: Path | None = None) -> None:
        self.port = port
        self.virtual_folder = virtual_folder
        self._gphoto2 = _library(virtual_folder)
        self._camera: Any = None

    def open(self) -> Summary:
        """Connect to the camera at the port; DeviceError when there is none."""
        if self.virtual_folder is not None and not self.virtual_folder.is_dir():
            raise DeviceError(
                self.port,
                field="virtual_folder",
                found=str(self.virtual_folder),
                expected="a folder",
            )
        gphoto2 = self._gphoto2
        try:
            ports = gphoto2.PortInfoList()
            ports.load()
            abilities = gphoto2.CameraAbilitiesList()
            abilities.load()
            here = abilities.detect(ports)
            at = {here.get_value(i): here.get_name(i) for i in range(here.count())}
            if self.port not in at:
                raise DeviceError(
                    f"port {self.port}",
                    found=", ".join(f"{name} at {port}" for port, name in at.items()) or "nothing",
                    expected="a camera at this port",
                    hint=HINTS[-105],
                )
            model = at[self.port]
            camera = gphoto2.Camera()
            camera.set_port_info(ports[ports.lookup_path(self.port)])
            camera.set_abilities(abilities[abilities.lookup_model(model)])
            camera.init()
        except gphoto2.GPhoto2Error as error:
            raise self._failure("connect", error) from None
        self._camera = camera
        return Summary(
            serial=self._serial(),
            model=model,
            **{name: self._setting(*keys) for name, keys in SETTINGS.items()},
        )

    def capture(self, at_s: float) -> Photograph:
        """Take one photograph and download it; it also stays on the camera, as a second copy.

        Args:
            at_s: time.monotonic() at which to trigger.
        """
        gphoto2 = self._gphoto2
        time.sleep(max(0.0, at_s - time.monotonic()))
        triggered_s = time.monotonic()
        try:
            path = self._camera.capture(gphoto2.GP_CAPTURE_IMAGE)
            exposed_s = time.monotonic()
            # The CameraFile must outlive the copy: its memory goes with it.
            file = self._camera.file_get(path.folder, path.name, gphoto2.GP_FILE_TYPE_NORMAL)
            data = bytes(memoryview(file.get_data_and_size()))
            told = self._camera.file_get_info(path.folder, path.name).file.size
        except gphoto2.GPhoto2Error as error:
            raise self._failure("capture", error) from None
        downloaded_s = time.monotonic()
        if len(data) != told or not data:
            raise DeviceError(
                self.port,
                field=path.name,
                found=f"{len(data)} bytes",
                expected=f"{told} bytes, as the camera says",
                hint="The download was cut; check the cable.",
            )
        sha256 = hashlib.sha256(data).hexdigest()
        return Photograph(data, sha256, path.name, triggered_s, exposed_s, downloaded_s)

    def close(self) -> None:
        """Let go of the camera."""
        if self._camera is not None:
            self._camera.exit()
            self._camera = None

    def _serial(self) -> str | None:
        # The virtual camera says 0.1 whichever it is: it cannot tell.
        if "VCAMERADIR" in os.environ:
            return None
        return self._setting("serialnumber", "eosserialnumber")

    def _setting(self, *names: str) -> str | None:
        """Value of the first of these settings that the camera has."""
        for value in self._values(names):
            return value
        return None

    def _values(self, names: tuple[str, ...]) -> Iterator[str]:
        for name in names:
            try:
                value = str(self._camera.get_single_config(name).get_value()).strip()
            except self._gphoto2.GPhoto2Error:
                continue
            if value:
                yield value

    def _failure(self, doing: str, error: Any) -> DeviceError:
        return DeviceError(
            self.port,
            field=doing,
            found=f"libgphoto2 error {error.code} ({error.string})",
            hint=HINTS.get(error.code, "Switch the camera off and on, then try again."),
        )
