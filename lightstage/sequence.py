"""Shots in order: what is lit and photographed."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from lightstage.errors import LightstageError, PatternError, one_error
from lightstage.patterns.drive import NO_PATTERNS, Drive, drive_levels
from lightstage.patterns.own import UserPattern
from lightstage.rig import Rig


@dataclasses.dataclass(frozen=True)
class Shot:
    """One pattern to be lit and photographed; levels (n,) in 0..1."""

    pattern: str
    levels: np.ndarray


def plan_shots(
    patterns: Sequence[str],
    rig: Rig,
    drive: Drive = "solid-angle",
    own: Mapping[str, UserPattern] = NO_PATTERNS,
    emitters: Collection[str] = (),
) -> tuple[Shot, ...]:
    """Shots of these patterns, in order, with the levels that are driven.

    Args:
        patterns: names.
        rig: the lights.
        drive: by the solid angle that lights stand for, or plain on and off.
        own: the user's own patterns by name.
        emitters: colours of the lights that are driven; none named: all.

    Raises:
        PatternError: every unknown or doubled pattern, in one message.
    """
    problems: list[LightstageError] = []
    shots = []
    for index, name in enumerate(patterns):
        if name in patterns[:index]:
            problems.append(
                PatternError(f"pattern {name!r}", found="twice", expected="each pattern once")
            )
            continue
        try:
            shots.append(Shot(name, drive_levels(name, rig, drive, own, emitters)))
        except PatternError as error:
            problems.append(error)
    if not patterns:
        problems.append(PatternError("sequence", found="no pattern", expected="at least one"))
    if problems:
        raise one_error(problems)
    return tuple(shots)
