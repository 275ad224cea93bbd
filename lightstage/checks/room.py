"""Findings about light that was left over: the room, a lamp that stays on, one that went out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from lightstage.checks.ball import BallModel
from lightstage.checks.config import ChecksConfig
from lightstage.checks.photo_measures import Photo
from lightstage.checks.stray import Stray, find_stray
from lightstage.checks.sums import Sum
from lightstage.findings import Finding, two_digits
from lightstage.rig import Rig

LAMP_SHARE = 0.003
"""Share of `full`: a lamp that adds or takes less is not distinct from noise and motion."""


@dataclasses.dataclass(frozen=True)
class Left:
    """Light left over in a shot.

    Attributes:
        pattern: of the shot.
        dark: whether that is a dark pattern itself.
        dark_known: whether a dark photograph was subtracted.
        sums: those that the pattern completes and that hold.
        light: camera to (r, c) green, share of white.
        wholes: camera to its photograph under `full`.
        shares: each sum's light left over, middle of the cameras, share of full.
    """

    pattern: str
    dark: bool
    dark_known: bool
    sums: tuple[Sum, ...]
    light: Mapping[str, np.ndarray]
    wholes: Mapping[str, Photo]
    shares: Mapping[Sum, float]


def room_findings(left: Left, model: BallModel, rig: Rig, config: ChecksConfig) -> list[Finding]:
    """The findings of the light left over; none where there is too little."""
    out = [] if left.dark else _disagreement(left, config)
    if out:
        return out
    stray = find_stray(model, left.light, left.wholes)
    if stray is None:
        return out
    if stray.lamp is not None and abs(stray.share) > LAMP_SHARE:
        return [_lamp(left, stray, rig)]
    share = stray.share
    if abs(share) <= config.warn_ambient_share:
        return out
    bad = abs(share) > config.max_ambient_share
    leak = left.dark or (share > 0 and not left.dark_known)
    measured = (
        f"light at {two_digits(100 * share)} % of full without a lamp"
        if leak
        else f"{left.sums[0]} off by {100 * share:+.2g} % of full in all cameras"
    )
    return [
        Finding(
            "retake" if bad else "warn",
            "dark-leak" if left.dark else "ambient" if leak else "sum",
            f"all cameras, pattern {left.pattern}",
            measured,
            f"at most {100 * config.warn_ambient_share:g} %",
            "Darken the room, or search for a lamp that does not go out."
            if leak
            else "The light of the three patterns was not the same: check the lamps' supply.",
            left.pattern,
            None,
        )
    ]


def _disagreement(left: Left, config: ChecksConfig) -> list[Finding]:
    """Ambient estimates of the axes must agree; the odd one of three or more is named."""
    if len(left.shares) < 2 or not left.sums:
        return []
    middle = float(np.median(list(left.shares.values())))
    out = []
    for one in left.sums:
        if one not in left.shares:
            continue  # no camera could show it
        off = left.shares[one] - middle
        others = [share for other, share in left.shares.items() if other != one]
        if len(left.shares) == 2:
            middle = others[0]
            off = left.shares[one] - middle
        if abs(off) <= config.warn_ambient_share:
            continue
        bad = abs(off) > config.max_ambient_share
        out += [
            Finding(
                "retake" if bad else "warn",
                "ambient-changed",
                f"all cameras, pattern {name}",
                f"{one.first} + {one.second} leave {two_digits(100 * left.shares[one])} % of "
                f"{one.whole} over, the other pairs {two_digits(100 * middle)} %",
                "the same from each pair",
                "Did room light change, or the lights flicker? Take both of the pair again.",
                name,
                None,
            )
            for name in (one.first, one.second)
        ]
    return out


def _lamp(left: Left, stray: Stray, rig: Rig) -> Finding:
    assert stray.lamp is not None
    light = rig.lights[stray.lamp]
    near = f", or one of {len(stray.near)} near it" if stray.near else ""
    name = f"lamp {light.id} ({light.name}{near})"
    on = stray.share > 0
    return Finding(
        "warn",
        "lamp-on" if on else "lamp-out",
        f"all cameras, pattern {left.pattern}",
        f"{two_digits(100 * abs(stray.share))} % of full {'too much' if on else 'missing'}, "
        f"as if {name} " + (f"were on at {stray.level:.1f}" if on else "had failed"),
        "the commanded lamps alone",
        "Inspect that part of the stage; retaking the pattern does not mend a lamp.",
        left.pattern,
        None,
    )
