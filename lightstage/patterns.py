"""Light patterns: names to drive levels, from the lights' positions. Pure, no device.

Names are those of the session format: full, dark, x+ .. z- (binary gradients), lin-x+ .. lin-z-
(linear gradients), olat-NNN, and @parallel / @cross after any of them (one polarisation bank).
"""

from __future__ import annotations

import re

import numpy as np

from lightstage.errors import PatternError
from lightstage.rig import Rig

BINARY = ("x+", "x-", "y+", "y-", "z+", "z-")
SEQUENCES: dict[str, tuple[str, ...]] = {
    "binary": ("full", *BINARY),
    "linear": ("full", *(f"lin-{name}" for name in BINARY)),
    "full": ("full",),
}
"""Named sequences of patterns that `capture` takes."""

ON_PLANE = 1e-6
"""A light nearer to a splitting plane than this share of the radius lies on it: half in each."""


def pattern_levels(name: str, rig: Rig) -> np.ndarray:
    """Drive levels of one pattern.

    Args:
        name: a pattern name.
        rig: the lights.

    Returns:
        (n,) float64 in 0..1, in the rig's order of lights. A binary pair sums to `full`.

    Raises:
        PatternError: an unknown name, or a light that the rig does not have.
    """
    base, _, polarisation = name.partition("@")
    levels = _unpolarised(base, name, rig)
    if "@" in name:
        if polarisation not in ("parallel", "cross"):
            raise _unknown(name)
        # Cameras' polarisers stand upright, so parallel is lit by the vertical bank and cross by
        # the horizontal one. The other way round cross would keep ten times as much of the mirror
        # reflection: a lamp at the side whose field follows its meridian is reflected best
        # (across the plane of incidence), one whose field follows its latitude hardly at all.
        bank = "vertical" if polarisation == "parallel" else "horizontal"
        levels = levels * np.array([light.bank == bank for light in rig.lights])
    return levels


def sequence_patterns(name: str) -> tuple[str, ...]:
    """Patterns of a named sequence, or of a comma-separated list of pattern names."""
    if name in SEQUENCES:
        return SEQUENCES[name]
    return tuple(part.strip() for part in name.split(",") if part.strip())


def _unpolarised(base: str, name: str, rig: Rig) -> np.ndarray:
    count = len(rig.lights)
    if base == "full":
        return np.ones(count)
    if base == "dark":
        return np.zeros(count)
    match = re.fullmatch(r"(lin-)?([xyz])([+-])", base)
    if match:
        linear, axis, sign = match.groups()
        radii = np.linalg.norm(rig.positions_mm, axis=1)
        along = rig.positions_mm[:, "xyz".index(axis)] / radii * (1.0 if sign == "+" else -1.0)
        if linear:
            return (1.0 + along) / 2.0
        return np.where(np.abs(along) < ON_PLANE, 0.5, (along > 0).astype(float))
    match = re.fullmatch(r"olat-(\d{3,})", base)
    if match:
        wanted = [int(match.group(1)) == light.id for light in rig.lights]
        if not any(wanted):
            raise PatternError(
                f"pattern {name}", found="no light of this id", expected=f"one of {count} lights"
            )
        return np.array(wanted, float)
    raise _unknown(name)


def _unknown(name: str) -> PatternError:
    return PatternError(
        f"pattern {name!r}",
        found="an unknown name",
        expected="full, dark, x+ x- y+ y- z+ z-, lin-x+ .., olat-NNN, each also @parallel, @cross",
        hint=f"Named sequences: {', '.join(SEQUENCES)}.",
    )
