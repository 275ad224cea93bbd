"""What single lights and shapes of light a pattern's table names, and whether they are there."""

from __future__ import annotations

import fnmatch
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.errors import LightstageError, PatternError, one_error
from lightstage.rig import Rig

HUGE = 1e300
"""TOML's whole numbers have no end; beyond this they are none here."""


def numbers(values: tuple[Any, ...], where: str, field: str, count: int) -> np.ndarray:
    """So many numbers as an array (count,), NaN and infinity among them; PatternError else."""
    good = [isinstance(v, (int, float)) and not isinstance(v, bool) for v in values]
    good = [ok and not abs(v) > HUGE for ok, v in zip(good, values, strict=True)]
    if len(values) != count or not all(good):
        found = counted(len(values), "value")
        if not all(good):
            found = repr(values[good.index(False)])
        raise PatternError(where, field=field, found=found, expected=counted(count, "number"))
    return np.array(values, float)


def check_levels(levels: np.ndarray, where: str, field: str) -> None:
    """PatternError, with the first place, where one of (n,) levels is not in 0..1."""
    bad = np.flatnonzero(~((levels >= 0) & (levels <= 1)))
    if len(bad):
        place = f"{field}[{bad[0]}]" if len(levels) > 1 else field
        raise PatternError(where, field=place, found=str(levels[bad[0]]), expected="0..1")


def chosen(ids: tuple[Any, ...], globs: tuple[Any, ...], where: str, rig: Rig) -> np.ndarray:
    """(n,) 1.0 for the lights of these ids, and those whose names match; PatternError on others."""
    problems: list[LightstageError] = []
    known = {light.id for light in rig.lights}
    for wanted in ids:
        if isinstance(wanted, bool) or not isinstance(wanted, int) or wanted not in known:
            problems.append(
                PatternError(where, field="lights", found=repr(wanted), expected="ids of the rig")
            )
    on = np.array([light.id in ids for light in rig.lights])
    for glob in globs:
        named = [isinstance(glob, str) and fnmatch.fnmatchcase(x.name, glob) for x in rig.lights]
        if not any(named):
            problems.append(
                PatternError(
                    where,
                    field="names",
                    found=f"no lamp named {glob!r}",
                    expected=f"such as {rig.lights[0].name!r} or 'arc00/*'",
                )
            )
        on |= named
    if not problems and not on.any():
        problems.append(
            PatternError(where, field="lights", found="no lamp", expected="at least one")
        )
    if problems:
        raise one_error(problems)
    return on.astype(float)


def shape(
    direction: tuple[Any, ...], cap_deg: Any, cosine: Any, where: str, rig: Rig
) -> np.ndarray:
    """(n,) 0..1 of a cap or a cosine around a direction; PatternError where no lamp has any."""
    toward = numbers(direction, where, "direction", 3)
    length = float(np.linalg.norm(toward))
    if not (np.isfinite(length) and length > 0):
        raise PatternError(
            where, field="direction", found=str(direction), expected="finite, not 0 0 0"
        )
    if (cap_deg is None) == (cosine is None):
        raise PatternError(
            where,
            field="direction",
            found="both cap_deg and cosine" if cosine is not None else "no shape",
            expected="cap_deg or cosine",
        )
    far = np.linalg.norm(rig.positions_mm, axis=1)
    along = np.clip(rig.positions_mm @ (toward / length) / far, -1.0, 1.0)
    if cap_deg is not None:
        angle = _between(cap_deg, 180.0, where, "cap_deg")
        # A lamp at the very rim belongs to the cap, whatever rounding gives.
        lit = (np.degrees(np.arccos(along)) <= angle + 1e-6).astype(float)
    else:
        lit = np.maximum(along, 0.0) ** _between(cosine, 1e6, where, "cosine")
    if not lit.any():
        raise PatternError(
            where, field="direction", found="no lamp there", expected="at least one lamp lit"
        )
    return np.asarray(lit)


def _between(value: Any, most: float, where: str, field: str) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not 0 < value <= most:
        raise PatternError(
            where, field=field, found=repr(value), expected=f"above 0, at most {most:g}"
        )
    return float(value)
