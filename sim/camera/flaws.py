"""How a laboratory differs from the ideal: lens, lamps, room, subject and sensor, by name or file.

`ideal` adds nothing to the sensor's own noise; `lab` is mild everything; `bad` is harsh. A TOML
file overrides a named set, which its key `based_on` names (`ideal` where absent).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.config import as_dict, make_config, read_toml
from sim.camera.sensor import SensorConfig
from sim.errors import SimError
from sim.light.lamps import LampConfig


@dataclasses.dataclass(frozen=True)
class LensConfig:
    """A lens.

    Attributes:
        f_number: aperture.
        sensor_long_mm: the sensor's longer side, from which a pixel's size follows.
        diffraction: whether the aperture blurs by diffraction.
        blur_um: standard deviation of the other aberrations' Gaussian blur, on the sensor.
        vignetting: share of light lost in the corners beside the cosine law.
        vignetting_spread: standard deviation of that share from camera to camera.
        cosine_fourth: whether light falls with the fourth power of the field angle's cosine.
        depth_of_field: whether what is off the plane of focus is blurred.
        focus_before_origin_mm: the plane of focus is this far from the origin toward the camera.
        focus_error_mm: standard deviation of that from camera to camera.
        distortion_k1: added to each camera's own k1 (rig.json has the sum).
    """

    f_number: float = 16.0
    sensor_long_mm: float = 35.9
    diffraction: bool = False
    blur_um: float = 0.0
    vignetting: float = 0.0
    vignetting_spread: float = 0.0
    cosine_fourth: bool = False
    depth_of_field: bool = False
    focus_before_origin_mm: float = 70.0
    focus_error_mm: float = 0.0
    distortion_k1: float = 0.0


@dataclasses.dataclass(frozen=True)
class PulseConfig:
    """Dimming by pulses, seen by a shutter that opens row after row.

    Attributes:
        frequency_hz: of the pulses; 0 where lamps are dimmed by current.
        readout_ms: from the first row's exposure to the last one's.
    """

    frequency_hz: float = 0.0
    readout_ms: float = 15.0


@dataclasses.dataclass(frozen=True)
class RoomConfig:
    """Light that does not come from the stage, the same from everywhere.

    Attributes:
        ambient: what a white diffuser reads of it, `full` being 1.
        ambient_rgb: its colour against the lamps' white.
    """

    ambient: float = 0.0
    ambient_rgb: tuple[float, float, float] = (1.0, 0.82, 0.6)


@dataclasses.dataclass(frozen=True)
class SwayConfig:
    """A head that does not hold still: a random walk that a neck pulls back.

    Attributes:
        sway_mm: standard deviation of each coordinate of the neck's place.
        sway_deg: standard deviation of the rotation about each axis.
        memory: share of a pose that is left at the next photograph.
        neck_mm: what the head turns about, world.
    """

    sway_mm: float = 0.0
    sway_deg: float = 0.0
    memory: float = 0.8
    neck_mm: tuple[float, float, float] = (0.0, -120.0, -40.0)


@dataclasses.dataclass(frozen=True)
class CaptureFlaws:
    """Everything that a simulated capture does to the light.

    `lamps` are what the stage's lights really shine; the rig of the session does not have it.
    """

    lens: LensConfig = LensConfig()
    lamps: LampConfig = dataclasses.field(default_factory=LampConfig)
    pulses: PulseConfig = PulseConfig()
    room: RoomConfig = RoomConfig()
    sway: SwayConfig = SwayConfig()
    sensor: SensorConfig = dataclasses.field(default_factory=SensorConfig)


PRESETS: dict[str, CaptureFlaws] = {
    "ideal": CaptureFlaws(),
    "lab": CaptureFlaws(
        lens=LensConfig(
            diffraction=True,
            blur_um=4.0,
            vignetting=0.12,
            vignetting_spread=0.02,
            cosine_fourth=True,
            depth_of_field=True,
            focus_error_mm=5.0,
            distortion_k1=-0.03,
        ),
        lamps=LampConfig(gain_spread=0.02, colour_spread=0.005),
        pulses=PulseConfig(frequency_hz=2000.0),
        room=RoomConfig(ambient=0.002),
        sway=SwayConfig(sway_mm=0.3, sway_deg=0.1),
        sensor=SensorConfig(iso=200),
    ),
    "bad": CaptureFlaws(
        lens=LensConfig(
            f_number=8.0,
            diffraction=True,
            blur_um=12.0,
            vignetting=0.45,
            vignetting_spread=0.08,
            cosine_fourth=True,
            depth_of_field=True,
            focus_error_mm=40.0,
            distortion_k1=-0.3,
        ),
        lamps=LampConfig(gain_spread=0.1, colour_spread=0.03),
        pulses=PulseConfig(frequency_hz=120.0),
        room=RoomConfig(ambient=0.05),
        sway=SwayConfig(sway_mm=3.0, sway_deg=1.5),
        sensor=SensorConfig(iso=3200, camera_spread=0.05, headroom=1.3),
    ),
}


def load_flaws(name_or_file: str) -> CaptureFlaws:
    """A named set of flaws, or one from a TOML file.

    Raises:
        SimError: no such name or file, or a value out of range.
        ConfigError: an unknown key or a value of another type.
    """
    if name_or_file in PRESETS:
        return PRESETS[name_or_file]
    path = Path(name_or_file)
    if not path.is_file():
        raise SimError(
            "flaws", found=name_or_file, expected=f"{', '.join(PRESETS)}, or a TOML file"
        )
    values = read_toml(path)
    base = values.pop("based_on", "ideal")
    if not isinstance(base, str) or base not in PRESETS:
        raise SimError(path, field="based_on", found=repr(base), expected=", ".join(PRESETS))
    flaws = make_config(CaptureFlaws, _merged(as_dict(PRESETS[base]), values), path)
    require_usable(flaws, path)
    return flaws


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`base` with the values of `over`, table by table."""
    out = dict(base)
    for key, value in over.items():
        known = out.get(key)
        if isinstance(known, dict) and isinstance(value, dict):
            value = {**known, **value}
        out[key] = value
    return out


def require_usable(flaws: CaptureFlaws, where: str | Path) -> None:
    """SimError for the first value that no apparatus can have."""
    lens, pulses, room, sway, sensor = (
        flaws.lens,
        flaws.pulses,
        flaws.room,
        flaws.sway,
        flaws.sensor,
    )
    ranges: list[tuple[str, Any, float, float]] = [
        ("lens.f_number", lens.f_number, 0.7, 128.0),
        ("lens.sensor_long_mm", lens.sensor_long_mm, 1.0, 200.0),
        ("lens.blur_um", lens.blur_um, 0.0, 1000.0),
        ("lens.vignetting", lens.vignetting, 0.0, 0.95),
        ("lens.vignetting_spread", lens.vignetting_spread, 0.0, 0.5),
        ("lens.focus_before_origin_mm", lens.focus_before_origin_mm, -500.0, 500.0),
        ("lens.focus_error_mm", lens.focus_error_mm, 0.0, 200.0),
        ("lens.distortion_k1", lens.distortion_k1, -2.0, 2.0),
        ("pulses.frequency_hz", pulses.frequency_hz, 0.0, 1e6),
        ("pulses.readout_ms", pulses.readout_ms, 0.0, 1000.0),
        ("room.ambient", room.ambient, 0.0, 10.0),
        ("room.ambient_rgb", room.ambient_rgb, 0.0, 10.0),
        ("sway.sway_mm", sway.sway_mm, 0.0, 50.0),
        ("sway.sway_deg", sway.sway_deg, 0.0, 30.0),
        ("sway.memory", sway.memory, 0.0, 0.999),
        ("sway.neck_mm", sway.neck_mm, -1000.0, 1000.0),
        ("sensor.black_dn", sensor.black_dn, 0, 16000),
        ("sensor.white_dn", sensor.white_dn, sensor.black_dn + 1, 65535),
        ("sensor.electrons_per_dn", sensor.electrons_per_dn, 0.01, 1000.0),
        ("sensor.read_noise_e", sensor.read_noise_e, 0.0, 1000.0),
        ("sensor.converter_noise_dn", sensor.converter_noise_dn, 0.0, 1000.0),
        ("sensor.full_well_e", sensor.full_well_e, 1.0, 1e7),
        ("sensor.sensitivity_rgb", sensor.sensitivity_rgb, 0.01, 10.0),
        ("sensor.crosstalk", sensor.crosstalk, -1.0, 2.0),
        ("sensor.camera_spread", sensor.camera_spread, 0.0, 0.2),
        ("sensor.headroom", sensor.headroom, 0.01, 10.0),
        ("sensor.iso", sensor.iso, 25, 409600),
        ("sensor.unit_exposure_s", sensor.unit_exposure_s, 1e-6, 60.0),
    ]
    shapes = {
        "room.ambient_rgb": (3,),
        "sway.neck_mm": (3,),
        "sensor.sensitivity_rgb": (3,),
        "sensor.crosstalk": (3, 3),
    }
    for field, value, low, high in ranges:
        try:
            number = np.asarray(value, float)
        except (TypeError, ValueError):
            number = np.array(np.nan)
        usable = (number >= low) & (number <= high)  # false for NaN
        if number.shape != shapes.get(field, ()) or not usable.all():
            size = "".join(f"{n} x " for n in shapes.get(field, ()))
            raise SimError(
                where, field=field, found=str(value), expected=f"{size}{low:g}..{high:g}"
            )
