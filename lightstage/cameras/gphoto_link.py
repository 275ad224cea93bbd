"""A libgphoto2 connection that retries on temporary errors; the library is an argument."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable
from typing import Any, TypeVar

from lightstage.cameras.camera import FREE_CARD
from lightstage.errors import DeviceError

T = TypeVar("T")
IO, CLAIMED, BUSY = -7, -53, -110
HINTS = {
    -1: "Is there free space, and is the lens able to focus?",
    -3: f"{FREE_CARD} Then switch it off and on.",
    -114: f"{FREE_CARD} Then switch it off and on.",
    IO: "Switch the camera off and on, or plug its cable in again.",
    CLAIMED: "Another program has the camera: stop the desktop's photo import "
    "(gvfs-gphoto2-volume-monitor on Linux, PTPCamera on macOS).",
    -105: "No such camera is connected; check cable and power.",
    BUSY: "The camera is busy; wait until it has written its pictures.",
}
"""What to try, by libgphoto2's error code."""


@dataclasses.dataclass(frozen=True)
class Patience:
    """How long the driver retries on temporary errors; the process's deadline is longer.

    Attributes:
        claimed_tries: openings while another program has the camera.
        claimed_pause_s: between them.
        busy_s: of repeating a command while the camera is busy.
        event_s: of waiting for a shot's files.
        quiet_s: without an event after which a shot is complete though the camera did not report
            it, or that a file which is still missing may take.
        drain_s: longest of emptying the queue of events.
    """

    claimed_tries: int = 6
    claimed_pause_s: float = 0.5
    busy_s: float = 5.0
    event_s: float = 10.0
    quiet_s: float = 1.0
    drain_s: float = 2.0


class Link:
    """One camera of the library at one port.

    Args:
        library: the module gphoto2.
        port: such as ``usb:001,004``.
        patience: how long temporary errors are retried.
        drain: empties the queue of events; a busy camera is one that has events to report.
        serial: the camera's report of its serial number, read after each connection.
    """

    def __init__(
        self,
        library: Any,
        port: str,
        patience: Patience,
        drain: Callable[[], None],
        serial: Callable[[], str | None],
    ) -> None:
        self.library = library
        self.port = port
        self.patience = patience
        self.model: str | None = None
        self._drain = drain
        self._serial = serial
        self._known_serial: str | None = None
        self._camera: Any = None

    @property
    def camera(self) -> Any:
        """The library's camera; DeviceError where it is not open."""
        if self._camera is None:
            raise DeviceError(self.port, found="not open", expected="open() first")
        return self._camera

    def connect(self) -> None:
        """Find the port and connect; retry while another program has the camera.

        Raises:
            DeviceError: no camera is there, it does not answer, or stays another program's.
        """
        tries = self.patience.claimed_tries
        for attempt in range(1, tries + 1):
            try:
                self._camera = self._init()
                self._known_serial = self._serial()
                return
            except self.library.GPhoto2Error as error:
                # A body that was cut off in the middle of a command needs a second greeting.
                if error.code not in (CLAIMED, IO, BUSY) or attempt == tries:
                    raise self.failure("connect", error) from None
                self.close()
                time.sleep(self.patience.claimed_pause_s)

    def call_with_retries(self, doing: str, call: Callable[[], T], repeatable: bool = True) -> T:
        """Call the library; retry while the camera is busy, and once after an I/O problem.

        Args:
            doing: the error's field.
            call: what to do; asks for `camera` each time, since that may be another one then.
            repeatable: whether it does no harm twice. A trigger does: after an I/O problem nobody
                knows whether it was heard.

        Raises:
            DeviceError: it failed for good, or another body answers after the connection was made
                again.
        """
        until = time.monotonic() + self.patience.busy_s
        pause_s = 0.05
        reconnected = False
        while True:
            try:
                return call()
            except self.library.GPhoto2Error as error:
                if error.code == BUSY and time.monotonic() + pause_s < until:
                    self._drain()
                    time.sleep(pause_s)
                    pause_s *= 2
                elif error.code == IO and repeatable and not reconnected:
                    reconnected = True
                    self._reconnect()
                else:
                    raise self.failure(doing, error) from None

    def close(self) -> None:
        """Let go of the camera."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with contextlib.suppress(self.library.GPhoto2Error):
                camera.exit()

    def failure(self, doing: str, error: Any) -> DeviceError:
        """An error of the library in words."""
        return DeviceError(
            self.port,
            field=doing,
            found=f"libgphoto2 error {error.code} ({error.string})",
            hint=HINTS.get(error.code, "Switch the camera off and on, then try again."),
        )

    def _init(self) -> Any:
        ports = self.library.PortInfoList()
        ports.load()
        abilities = self.library.CameraAbilitiesList()
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
        camera = self.library.Camera()
        camera.set_port_info(ports[ports.lookup_path(self.port)])
        camera.set_abilities(abilities[abilities.lookup_model(at[self.port])])
        camera.init()
        self.model = at[self.port]
        return camera

    def _reconnect(self) -> None:
        before = self._known_serial
        self.close()
        self.connect()
        if self._known_serial != before:
            found, self._known_serial = self._known_serial, before
            self.close()
            raise DeviceError(
                self.port,
                field="serial",
                found=found or "none",
                expected=f"{before}, which was here before",
            )
