"""The lamps that processing uses: as measured where a session has that, else the rig's."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from lightstage.formats.environment import stage_lights
from lightstage.formats.lights import read_measured_lights
from lightstage.formats.scale import full_levels
from lightstage.formats.session import Session
from lightstage.rig import Light, Rig
from processing.errors import ProcessingError

Source = Literal["measured", "nominal"]
NO_STRAY: Mapping[str, np.ndarray] = MappingProxyType({})


@dataclasses.dataclass(frozen=True)
class Lamps:
    """The L lights of a rig, in its order.

    Attributes:
        position_mm: (L, 3).
        rgb: (L, 3) what a white diffuser at the origin that faces the light reads at level 1.
        exponent: intensity falls with the cosine to the lamp's axis to this power.
        stray: see formats.lights.MeasuredLights.
        source: whence they are known.
    """

    position_mm: np.ndarray
    rgb: np.ndarray
    exponent: float
    stray: Mapping[str, np.ndarray]
    source: Source


def session_lamps(session: Session) -> Lamps:
    """The lamps of a session, on its scale.

    A perfect white diffuser at the origin, facing +z, reads 1 under the session's `full`: with
    measured gains in each channel, since colours are balanced to the LEDs' white; with nominal ones
    where all gains are 1.

    Raises:
        FormatError: a file of measured lights that does not fit the rig.
        ProcessingError: measured lights of which none shines on such a diffuser in some channel.
    """
    full = full_levels(session)
    if session.file.calibration.lights is None:
        return nominal_lamps(session.rig, full)
    path = session.root / session.file.calibration.lights
    measured = read_measured_lights(path, session.rig)
    rig = measured_rig(session.rig, measured.position_mm, measured.rgb_gain)
    lamps = nominal_lamps(rig, full)
    facing = np.clip(rig.positions_mm[:, 2] / np.linalg.norm(rig.positions_mm, axis=1), 0, None)
    white = (full * facing) @ lamps.rgb
    if not (white > 0).all():
        raise ProcessingError(
            path,
            field="lights",
            found=f"white that reads {', '.join(f'{value:.3g}' for value in white)}",
            expected="light in every channel on a surface that faces +z",
            hint="Measure the lights again: lightstage calibrate mirror, grey.",
        )
    return Lamps(
        lamps.position_mm, lamps.rgb / white, measured.exponent, measured.stray, "measured"
    )


def nominal_lamps(rig: Rig, full: np.ndarray | None = None) -> Lamps:
    """The lamps as in a rig, on the scale of formats.environment.stage_lights.

    Args:
        rig: the lights.
        full: (L,) levels of `full`; every light at level 1 where absent.
    """
    shining = rig.rgb_gains.max(axis=1) > 0
    rgb = np.zeros((len(rig.lights), 3))
    rgb[shining] = stage_lights(rig, np.ones(len(rig.lights)), "all", full).rgb
    return Lamps(rig.positions_mm, rgb, 0.0, NO_STRAY, "nominal")


def measured_rig(rig: Rig, position_mm: np.ndarray, rgb_gain: np.ndarray) -> Rig:
    """The rig with its lamps at other places (L, 3), of other gains (L, 3)."""

    def moved(light: Light, place: np.ndarray, gain: np.ndarray) -> Light:
        x, y, z = (float(value) for value in place)
        r, g, b = (float(value) for value in gain)
        return dataclasses.replace(light, position_mm=(x, y, z), rgb_gain=(r, g, b))

    rows = zip(rig.lights, position_mm, rgb_gain, strict=True)
    return dataclasses.replace(rig, lights=tuple(moved(*row) for row in rows))
