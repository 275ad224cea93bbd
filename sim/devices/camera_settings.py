"""What can be read from a simulated camera, and changed."""

from __future__ import annotations

import dataclasses
import decimal
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sim.camera.exposure import exposure_gain
from sim.errors import SimError

if TYPE_CHECKING:
    # Each camera's own process imports this file, and none needs what they import: numba, SciPy.
    from sim.camera.optics import Lens
    from sim.camera.sensor import Sensor

SUFFIXES = {"RAW": (".DNG",), "JPEG": (".JPG",), "RAW+JPEG": (".DNG", ".JPG")}
"""Files of one shot, by image format."""


@dataclasses.dataclass(frozen=True)
class CameraSettings:
    """What can be read from a camera, and changed by hand.

    Attributes:
        serial: of the body.
        model: maker and name.
        iso: sensitivity, a number.
        shutter: seconds.
        aperture: f-number.
        white_balance: name of the preset.
        image_format: ``RAW``, ``JPEG`` or ``RAW+JPEG``.
        mode: of exposure: ``Manual``, or an automatic one.
        focus: ``Manual``, or an automatic one.
        battery_percent: charge.
        card_files: how many files the card can hold.
        card_bytes: how much of them.
        clock_offset_s: the camera's clock less the true time; None where it does not report it, and
            writes no time into its files.
        firmware: version of its own software.
        owner: written into its files.
        artist: the same.
        copyright: the same.
        place: ``off``, or what it writes of where it is.
        lens: what is mounted.
    """

    serial: str
    model: str
    iso: str = "100"
    shutter: str = "1/60"
    aperture: str = "f/8"
    white_balance: str = "Daylight"
    image_format: str = "RAW"
    mode: str = "Manual"
    focus: str = "Manual"
    battery_percent: int = 100
    card_files: int = 100_000
    card_bytes: int = 64_000_000_000
    clock_offset_s: float | None = 0.0
    firmware: str = "1.00"
    owner: str = ""
    artist: str = ""
    copyright: str = ""
    place: str = "off"
    lens: str = "Simulated 50 mm f/1.8"

    def __post_init__(self) -> None:
        """Refuse what no camera can be set to."""
        self.gain()
        if self.image_format not in SUFFIXES:
            raise SimError(
                "camera settings",
                field="image_format",
                found=repr(self.image_format),
                expected=f"one of {', '.join(SUFFIXES)}",
            )

    def gain(self) -> float:
        """Counts for one unit of light, up to a constant; SimError on a text without meaning."""
        return exposure_gain(self.iso, self.shutter, self.aperture)

    def suffixes(self) -> tuple[str, ...]:
        """Of the files that one shot makes, in the order in which they are written."""
        return SUFFIXES[self.image_format]


def exposed_with(
    sensors: Mapping[str, Sensor], lenses: Mapping[str, Lens]
) -> dict[str, dict[str, Any]]:
    """The settings under which photographs are simulated, so that cameras report the truth.

    Args:
        sensors: camera id to sensor.
        lenses: camera id to lens.

    Returns:
        Camera id to ISO, shutter and aperture, by the names of CameraSettings.
    """
    return {
        camera_id: {
            "iso": str(sensor.config.iso),
            "shutter": _plain(sensor.exposure_s),
            "aperture": f"f/{lenses[camera_id].config.f_number:g}",
        }
        for camera_id, sensor in sensors.items()
    }


def changed(settings: CameraSettings, name: str, value: Any) -> CameraSettings:
    """Settings with another value.

    Raises:
        SimError: no such setting, or a value of another kind or without meaning.
    """
    known = dataclasses.asdict(settings)
    if name not in known:
        raise SimError(
            "camera settings", field=name, found="unknown", expected=f"one of {', '.join(known)}"
        )
    kind = type(known[name])
    try:
        return dataclasses.replace(settings, **{name: kind(value)})
    except ValueError:
        raise SimError(
            "camera settings", field=name, found=repr(value), expected=kind.__name__
        ) from None


def _plain(seconds: float) -> str:
    """A time of six digits, without an exponent, which cameras do not write."""
    return format(decimal.Decimal(f"{seconds:.6g}"), "f")
