"""What a capture asks of a camera."""

from __future__ import annotations

import dataclasses
from typing import Protocol

VERIFIABLE = ("serial", "model", "iso", "shutter", "aperture")
"""What a camera is asked to tell about itself. One that cannot tell must be allowed by name."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """What a camera tells about itself; None where it cannot."""

    serial: str | None
    model: str | None
    iso: str | None
    shutter: str | None
    aperture: str | None

    def untold(self) -> list[str]:
        """Names of what the camera cannot tell."""
        return [name for name in VERIFIABLE if getattr(self, name) is None]


@dataclasses.dataclass(frozen=True)
class Photograph:
    """One photograph as the camera gave it.

    Attributes:
        data: the file's bytes.
        sha256: of the bytes where they left the driver, in hexadecimal.
        name: the file's name on the camera.
        triggered_s: time.monotonic() just before the trigger, comparable between processes.
        exposed_s: when the camera said that the picture was taken.
        downloaded_s: when the last byte was there.
    """

    data: bytes
    sha256: str
    name: str
    triggered_s: float
    exposed_s: float
    downloaded_s: float


class CameraDriver(Protocol):
    """What a driver does inside a camera's own process, one call at a time."""

    def open(self) -> Summary:
        """Connect, and say what the camera tells about itself; DeviceError when it cannot."""

    def capture(self, at_s: float) -> Photograph:
        """Trigger at a time of time.monotonic() and download; DeviceError when it fails."""

    def close(self) -> None:
        """Let go of the camera."""


class CameraDevice(Protocol):
    """One camera. Every method raises DeviceError, at the latest when its deadline is over."""

    @property
    def id(self) -> str:
        """The rig's name for it."""

    def open(self) -> Summary:
        """Connect, and say what the camera tells about itself."""

    def capture(self, at_s: float) -> Photograph:
        """Trigger at a time of time.monotonic() (at once if it is past) and download."""

    def close(self) -> None:
        """Let go of the camera; never raises, never waits long."""
