"""What a capture sends to the lights for a pattern: levels by solid angle, or plain on and off."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from lightstage.errors import PatternError
from lightstage.patterns.names import bank_mask, complement, pattern_levels
from lightstage.patterns.own import UserPattern
from lightstage.patterns.weights import light_weights
from lightstage.rig import Rig

Drive = Literal["solid-angle", "on-off"]
"""`solid-angle`: each lamp as strong as the solid angle it represents, so that `full` is an even
field; `on-off`: every light that is lit whole at level 1."""

STEPS = 65535
"""Steps of a level on the 16-bit wire. Levels are whole steps, so that what is recorded is what was
driven, and a pair sums to `full` to the step."""

NO_PATTERNS: Mapping[str, UserPattern] = MappingProxyType({})


def drive_levels(
    name: str,
    rig: Rig,
    drive: Drive = "solid-angle",
    own: Mapping[str, UserPattern] = NO_PATTERNS,
    emitters: Collection[str] = (),
) -> np.ndarray:
    """Levels that a capture drives the lights with for a pattern.

    A pair (x+ and x-, lin-x+ and lin-x-, mux-1 and mux-2) sums to `full` to the last step, and so
    do the two banks of a pattern to the pattern. Of an odd number of steps, a light on a splitting
    plane gives the odd one to the first of the pair. A single light (olat-NNN) makes no field that
    could be even: it is driven at level 1 either way.

    Args:
        name: a pattern's name, of the session format or of `own`.
        rig: the lights.
        drive: see `Drive`.
        own: the user's patterns by name.
        emitters: colours of the lights that are driven, all others stay dark in every pattern;
            none named: all are driven.

    Returns:
        (n,) float64, whole multiples of 1 / 65535 in 0..1.

    Raises:
        PatternError: an unknown name, a light that the rig does not have or that is none of
            `emitters`, or a colour of no light.
    """
    driven = emitter_mask(rig, emitters)
    levels = _all_emitters(name, rig, drive, own, driven)
    if name.startswith("olat-") and levels.any() and not (levels * driven).any():
        raise PatternError(
            f"pattern {name}",
            found="a light of another colour",
            expected=f"one of {', '.join(emitters)}, as in --emitters",
        )
    return levels * driven


def emitter_mask(rig: Rig, emitters: Collection[str]) -> np.ndarray:
    """(n,) 1.0 for the lights of these colours, all where none is named.

    Raises:
        PatternError: a colour of no light.
    """
    if not emitters:
        return np.ones(len(rig.lights))
    known = [str(colour) for colour in rig.colours if colour is not None]
    unknown = [name for name in emitters if name not in known]
    if unknown:
        raise PatternError(
            "--emitters",
            found=", ".join(map(repr, unknown)),
            expected=f"some of {', '.join(known)}" if known else "lights with `colour` in rig.json",
            hint="" if known else "All lights of this rig are alike: leave --emitters out.",
        )
    return np.asarray(sum(rig.colours[name].astype(float) for name in dict.fromkeys(emitters)))


def split_emitters(text: str) -> tuple[str, ...]:
    """Colours as the command line has them, with commas between."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _all_emitters(
    name: str, rig: Rig, drive: Drive, own: Mapping[str, UserPattern], driven: np.ndarray
) -> np.ndarray:
    base = name.partition("@")[0]
    whole = np.ones(len(rig.lights))
    if drive == "solid-angle":
        whole = light_weights(rig)
        # The strongest of those that are lit is at level 1.
        whole = np.minimum(whole / whole[driven > 0].max(), 1.0)
    if base in own:
        mine = own[base]
        levels = mine.levels * whole if mine.is_field else mine.levels
        return np.asarray(np.floor(levels * STEPS + 0.5) / STEPS * bank_mask(name, rig))
    try:
        plain = pattern_levels(name, rig)
    except PatternError as error:
        if not own:
            raise
        known = f"{error.expected}; of your own: {', '.join(own)}"
        raise PatternError(
            error.where, found=error.found, expected=known, hint=error.hint
        ) from None
    if base.startswith("olat-"):
        return plain
    full = np.floor(whole * STEPS + 0.5)
    mate = complement(base)
    if mate is not None and base.endswith(("-", "-2")):
        steps = full - np.floor(full * pattern_levels(mate, rig) + 0.5)
        return np.asarray(steps / STEPS * bank_mask(name, rig))
    return np.asarray(np.floor(full * plain + 0.5) / STEPS)
