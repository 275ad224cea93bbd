"""Measured lights, lightstage.lights/1: where each lamp is and what it gives.

    {"schema": "lightstage.lights/1", "exponent": 1.0,
     "lights": [{"id": 0, "position_mm": [x, y, z], "rgb_gain": [r, g, b],
                 "position_sigma_mm": 3.1, "residual_px": 0.2, "gain_sigma": 0.01}, ...],
     "stray": {"x+": [3 channels [3 rows [4 numbers]]], ...},
     "facts": {...}}

`rgb_gain` is the radiant intensity relative to nominal, as rig.json's; `exponent` that of the
cosine to a lamp's axis, which points at the origin, by which its intensity falls. `stray` is light
of a pattern that no lamp of the list explains (walls, lamps' housings). Only differences of gains
between lamps count: on a session's scale a white facing +z under `full` reads 1 in each channel.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError, LightstageError, one_error
from lightstage.formats.fields import array_of, whole_number
from lightstage.formats.files import read_json, write_json
from lightstage.rig import Rig

SCHEMA = "lightstage.lights/1"
MOST_EXPONENT = 50.0
"""A spotlight narrower than this does not light a head evenly."""
NEAREST_MM = 1.0
OTHER_UNIT = 2.0
"""A stage that is so many times as large as the rig's, or as small, is in another unit."""
MOST_OFF = 0.25
"""Share of the stage's radius by which half of the lamps may be off their nominal places: more are
other lamps' places, or in other axes."""


@dataclasses.dataclass(frozen=True)
class MeasuredLights:
    """What was measured of a rig's L lights, in the rig's order.

    Attributes:
        position_mm: (L, 3).
        rgb_gain: (L, 3) at least 0.
        exponent: of the fall-off with the angle to the lamp's axis.
        stray: pattern to (3, 3, 4): a white at the origin with normal n gets, in channel c, beside
            the lamps' light, m n . (A n + b) with [A | b] = stray[c] and m the lamps' irradiance
            averaged over all directions. Affine and quadratic in n; patterns may be missing.
        position_sigma_mm: (L,) standard deviation of a position, along its worst axis.
        residual_px: (L,) root mean square over the photographs' highlights; NaN where there are
            none, and the position is the rig's.
        gain_sigma: (L,) standard deviation of a gain, as a share of it.
        facts: figures of the whole, JSON-ready.
    """

    position_mm: np.ndarray
    rgb_gain: np.ndarray
    exponent: float
    stray: Mapping[str, np.ndarray]
    position_sigma_mm: np.ndarray
    residual_px: np.ndarray
    gain_sigma: np.ndarray
    facts: Mapping[str, Any]


def write_measured_lights(lights: MeasuredLights, rig: Rig, path: Path) -> Path:
    """Write measured lights atomically; returns `path`."""
    columns = (
        lights.position_mm.tolist(),
        lights.rgb_gain.tolist(),
        lights.position_sigma_mm.tolist(),
        [None if np.isnan(value) else float(value) for value in lights.residual_px],
        lights.gain_sigma.tolist(),
    )
    names = ("position_mm", "rgb_gain", "position_sigma_mm", "residual_px", "gain_sigma")
    entries = [
        {"id": light.id} | dict(zip(names, values, strict=True))
        for light, *values in zip(rig.lights, *columns, strict=True)
    ]
    return write_json(
        path,
        {
            "schema": SCHEMA,
            "exponent": lights.exponent,
            "lights": entries,
            "stray": {name: value.tolist() for name, value in lights.stray.items()},
            "facts": dict(lights.facts),
        },
    )


def read_measured_lights(path: Path, rig: Rig) -> MeasuredLights:
    """Read measured lights of a rig.

    Args:
        path: the file. Lights may be in any order; those that the rig lacks are left out.
        rig: whose lights they are.

    Raises:
        FormatError: another schema, or all that is wrong in the file in one message.
    """
    value = read_json(path, SCHEMA)
    problems: list[LightstageError] = []

    def fault(field: str, found: str, expected: str) -> None:
        problems.append(FormatError(path, field=field, found=found, expected=expected))

    entries = value.get("lights")
    listed = entries if isinstance(entries, list) else []
    by_id: dict[int, dict[str, Any]] = {}
    for entry in listed:
        number = whole_number(entry.get("id")) if isinstance(entry, dict) else None
        if type(number) is not int:
            continue
        if by_id.setdefault(number, entry) is not entry:
            fault("lights", f"lamp {number} twice", "each once")
    rows = []
    for light in rig.lights:
        entry = by_id.get(light.id)
        if entry is None:
            fault("lights", f"no lamp {light.id}", "every lamp of the rig, measured with it")
            continue
        field = f"lamp {light.id}"
        place = _numbers(entry.get("position_mm"), (3,))
        gain = _numbers(entry.get("rgb_gain"), (3,))
        if not (np.isfinite(place).all() and np.linalg.norm(place) >= NEAREST_MM):
            fault(f"{field}.position_mm", str(entry.get("position_mm")), "three numbers, mm")
        if not (np.isfinite(gain).all() and (gain >= 0).all()):
            fault(f"{field}.rgb_gain", str(entry.get("rgb_gain")), "three numbers of at least 0")
        rest = [_optional(entry, name) for name in ("position_sigma_mm", "residual_px")]
        rows.append([*place, *gain, *rest, _optional(entry, "gain_sigma")])
    exponent = _numbers(value.get("exponent", 0.0), ())
    if not 0 <= exponent <= MOST_EXPONENT:
        fault("exponent", str(value.get("exponent")), f"a number of 0..{MOST_EXPONENT:g}")
    stray = {}
    given = value.get("stray", {})
    for name, cells in (given if isinstance(given, dict) else {"": given}).items():
        stray[name] = _numbers(cells, (3, 3, 4))
        if not np.isfinite(stray[name]).all():
            fault(f"stray.{name}", "something else", "3 x 3 x 4 finite numbers")
    if not problems and not any(row[3] + row[4] + row[5] > 0 for row in rows):
        fault("lights", "no lamp that shines", "gains above 0")
    if problems:
        raise one_error(problems)
    table = np.array(rows, float)
    _require_places(table[:, :3], rig, path)
    facts = value.get("facts", {})
    return MeasuredLights(
        position_mm=table[:, :3],
        rgb_gain=table[:, 3:6],
        exponent=float(exponent),
        stray=stray,
        position_sigma_mm=table[:, 6],
        residual_px=table[:, 7],
        gain_sigma=table[:, 8],
        facts=facts if isinstance(facts, dict) else {},
    )


def _require_places(places: np.ndarray, rig: Rig, path: Path) -> None:
    """Refuse (L, 3) places in another unit than the rig's, in other axes, or of other lamps."""
    radius, nominal = (
        float(np.median(np.linalg.norm(p, axis=1))) for p in (places, rig.positions_mm)
    )
    if not 1 / OTHER_UNIT <= radius / nominal <= OTHER_UNIT:
        raise FormatError(
            path,
            field="lights[].position_mm",
            found=f"a stage of {radius:.4g} mm radius (median)",
            expected=f"about {nominal:.4g} mm, as in rig.json",
            hint="Positions are in mm; were they in metres, cm or inches?",
        )
    off = float(np.median(np.linalg.norm(places - rig.positions_mm, axis=1)))
    if off > MOST_OFF * nominal:
        raise FormatError(
            path,
            field="lights[].position_mm",
            found=f"lamps {off:.4g} mm from their places in rig.json (median)",
            expected=f"at most {MOST_OFF * nominal:.4g} mm",
            hint="Are the axes those of the rig, and the ids those of the same lamps?",
        )


def _numbers(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """`value` as numbers of a shape; NaN where it is something else."""
    try:
        return array_of(value, *shape)
    except ValueError:
        return np.full(shape, np.nan)


def _optional(entry: Mapping[str, Any], name: str) -> float:
    return float(_numbers(entry.get(name), ()))
