"""What a capture asks of a camera."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Protocol

FREE_CARD = "Copy its photographs away and format it, or put a larger card in."
"""What to do about a full card."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """A camera's own report of its settings; None where it cannot report one.

    Attributes:
        serial: of the body.
        model: maker and name.
        firmware: version of the body's own software.
        mode: exposure mode; Manual is wanted.
        iso: sensitivity.
        shutter: exposure time, seconds.
        aperture: f-number.
        white_balance: the preset's name.
        image_format: of the files that one shot makes.
        focus: focus mode; Manual is wanted.
        battery_percent: charge.
        card_free_bytes: what still fits on its card.
        clock_offset_s: its clock less this computer's.
        owner: the field that goes into each file; empty is wanted.
        artist: the same.
        copyright: the same.
        place: whether it writes where it is (GPS) into its files: ``off``, or what is found.
        lens: what is mounted, for people; nothing is decided by it.
    """

    serial: str | None = None
    model: str | None = None
    firmware: str | None = None
    mode: str | None = None
    iso: str | None = None
    shutter: str | None = None
    aperture: str | None = None
    white_balance: str | None = None
    image_format: str | None = None
    focus: str | None = None
    battery_percent: float | None = None
    card_free_bytes: int | None = None
    clock_offset_s: float | None = None
    owner: str | None = None
    artist: str | None = None
    copyright: str | None = None
    place: str | None = None
    lens: str | None = None

    def not_readable(self) -> list[str]:
        """Names of what the camera cannot report."""
        return [name for name in VERIFIABLE if getattr(self, name) is None]


VERIFIABLE = tuple(f.name for f in dataclasses.fields(Summary) if f.name != "lens")
"""Settings that a camera must report. What one cannot report must be allowed by name."""


@dataclasses.dataclass(frozen=True, slots=True)  # a capture remembers very many
class CardFile:
    """A file on a camera's card.

    Attributes:
        name: the whole path on the card; a name may come again after the card was emptied.
        size: bytes, as the camera reports it.
    """

    name: str
    size: int


@dataclasses.dataclass(frozen=True)
class Exposure:
    """One shot that is on the card.

    Attributes:
        files: of this shot alone; the RAW first where there is one.
        triggered_s: time.monotonic() just before the trigger, comparable between processes.
        exposed_s: when the camera reported that the photograph was there.
    """

    files: tuple[CardFile, ...]
    triggered_s: float
    exposed_s: float


@dataclasses.dataclass(frozen=True)
class Download:
    """A file that was brought from the card.

    Attributes:
        size: bytes written.
        sha256: of the bytes where they left the driver, in hexadecimal.
        seconds: from asking to the last byte written.
    """

    size: int
    sha256: str
    seconds: float


class CameraDriver(Protocol):
    """What a driver does inside a camera's own process, one call at a time.

    Every method raises DeviceError where the camera fails, CaptureError where this computer's disk
    does.
    """

    def open(self) -> Summary:
        """Connect, and return the camera's summary."""

    def summary(self) -> Summary:
        """The same, read anew."""

    def change(self, name: str, value: str) -> None:
        """Set a field of Summary by its name."""

    def card(self) -> tuple[CardFile, ...]:
        """Every photograph on the card, oldest first."""

    def trigger(self, at_s: float) -> Exposure:
        """Trigger at a time of time.monotonic() (at once if it is past); wait for the files."""

    def download(self, name: str, path: Path) -> Download:
        """Write a card's file to `path`, which must not exist, and flush it to the disk."""

    def delete(self, name: str) -> None:
        """Remove a file from the card."""

    def close(self) -> None:
        """Let go of the camera."""


class CameraDevice(Protocol):
    """One camera, supervised: the same as CameraDriver, in a process of its own.

    Every method raises DeviceError, at the latest when its deadline is over; the camera's process
    is ended then, and `restart` is what brings it back.
    """

    @property
    def id(self) -> str:
        """The rig's name for it."""

    def open(self) -> Summary:
        """Connect, and return the camera's summary."""

    def restart(self) -> Summary:
        """End the process, find the same body again by its serial number, and connect."""

    def summary(self) -> Summary:
        """The camera's summary, read anew."""

    def change(self, name: str, value: str) -> None:
        """Set a field of Summary by its name."""

    def card(self) -> tuple[CardFile, ...]:
        """Every photograph on the card, oldest first."""

    def trigger(self, at_s: float, pattern: str = "*") -> Exposure:
        """Trigger at a time of time.monotonic() and wait for the shot's files (pattern: steps)."""

    def download(self, name: str, path: Path, pattern: str = "*") -> Download:
        """Write a card's file to `path`, which must not exist, and flush it to the disk."""

    def delete(self, name: str) -> None:
        """Remove a file from the card."""

    def close(self) -> None:
        """Let go of the camera; never raises, never waits long."""
