"""The scale of a session's light: what levels a perfect white reads 1.0 under.

The session format has a perfect white diffuser at the origin, facing +z, lit by `full`, read 1.0;
and `full` is what the session really drove: level 1 everywhere on a stage that knows on and off
only, less where lights are crowded on one that drives them by the solid angle they stand for.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.colour import SCHEMA as COLOUR_SCHEMA
from lightstage.formats.environment import white_reading
from lightstage.formats.fields import SHOWN, array_of
from lightstage.formats.files import read_json
from lightstage.formats.session import Session
from lightstage.patterns.names import complement, pattern_levels


def full_levels(session: Session) -> np.ndarray:
    """Levels of `full` in a session, as far as it recorded what it drove.

    In this order: `full` itself; a pair that sums to it, such as x+ and x-; the same of the two
    banks of polarised shots; what the colour calibration was lit by; every light at level 1.

    Returns:
        (n,) float64.

    Raises:
        FormatError: a colour calibration whose levels do not fit the rig.
    """
    driven = {name: np.array(d.levels, float) for name, d in session.file.patterns.items()}

    def recorded(base: str) -> np.ndarray | None:
        if base in driven:
            return driven[base]
        banks = [driven.get(f"{base}@{bank}") for bank in ("parallel", "cross")]
        return None if banks[0] is None or banks[1] is None else banks[0] + banks[1]

    full = recorded("full")
    if full is not None:
        return full
    for base in (name.partition("@")[0] for name in driven):
        mate = complement(base)
        one, other = recorded(base), None if mate is None else recorded(mate)
        if one is not None and other is not None:
            return one + other
    calibrated = colour_levels(session)
    return pattern_levels("full", session.rig) if calibrated is None else calibrated


def colour_levels(session: Session) -> np.ndarray | None:
    """(n,) levels that the chart of a session's colour calibration was lit by.

    It is the field `full_levels` of the calibration's file; None where there is no such field: the
    chart was lit by the session's own `full` then.

    Raises:
        FormatError: another number of levels than lights, or one outside 0..1.
    """
    if session.file.calibration.colour is None:
        return None
    path = session.root / session.file.calibration.colour
    return chart_levels(read_json(path, COLOUR_SCHEMA), len(session.rig.lights), path)


def chart_levels(colour: Mapping[str, Any], count: int, path: Path) -> np.ndarray | None:
    """(n,) the field `full_levels` of a colour calibration's value; None where it has none.

    Raises:
        FormatError: another number of levels than `count`, or one outside 0..1.
    """
    value = colour.get("full_levels")
    if value is None:
        return None
    try:
        levels = array_of(value, count)
    except ValueError:
        levels = np.zeros(0)
    good = levels.size > 0 and ((levels >= 0) & (levels <= 1)).all() and levels.any()
    if not good:
        raise FormatError(
            path,
            field="full_levels",
            found=_found(value, count),
            expected=f"{counted(count, 'level')} of 0..1, one a lamp, not all dark",
            hint="It is what the chart was lit by; make the calibration again with this rig.",
        )
    return levels


def _found(value: Any, count: int) -> str:
    """What there is in place of so many levels."""
    if not isinstance(value, list):
        return ascii(value)[:SHOWN]
    return "values not all in 0..1" if len(value) == count else counted(len(value), "value")


def raw_scale(session: Session) -> float:
    """What colours from the session's calibration are multiplied by to be on the session's scale.

    1 where the chart was lit as the session's `full` was; else a white under `full` would not read
    1 by that calibration.
    """
    calibrated = colour_levels(session)
    if calibrated is None:
        return 1.0
    full = full_levels(session)
    return white_reading(session.rig, calibrated) / white_reading(session.rig, full)
