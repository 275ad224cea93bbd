"""Shots in order, and what must hold before a light goes on: flash rate and lights' duty."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from lightstage.errors import ConfigError, LightstageError, PatternError, one_error
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig


@dataclasses.dataclass(frozen=True)
class SafetyConfig:
    """Limits for the person in the stage and for its lights.

    Attributes:
        max_flashes_per_s: flashes in any second; three is the limit below which photosensitive
            people are held to be safe [WCAG-Flashes].
        light_interval_s: shortest time between two changes of light; a capture waits for it.
        max_light_on_s: time at full level that one light may be on in one capture.
    """

    max_flashes_per_s: float = 3.0
    light_interval_s: float = 0.4
    max_light_on_s: float = 600.0


@dataclasses.dataclass(frozen=True)
class Shot:
    """One pattern to be lit and photographed; levels (n,) in 0..1."""

    pattern: str
    levels: np.ndarray


def plan_shots(patterns: Sequence[str], rig: Rig) -> tuple[Shot, ...]:
    """Shots of these patterns, in order.

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
            shots.append(Shot(name, pattern_levels(name, rig)))
        except PatternError as error:
            problems.append(error)
    if not patterns:
        problems.append(PatternError("sequence", found="no pattern", expected="at least one"))
    if problems:
        raise one_error(problems)
    return tuple(shots)


def flash_rate_per_s(shots: Sequence[Shot], light_interval_s: float) -> float:
    """Most flashes in any second, if lights change as fast as they may.

    Every change of any light counts as a flash, the first one and the last dark included; a flash
    in the sense of [WCAG-Flashes] is a pair of opposing changes, so this is the worst case.
    """
    states = [np.zeros_like(shots[0].levels), *(shot.levels for shot in shots)]
    states.append(states[0])
    changes_s = [
        index * light_interval_s
        for index in range(1, len(states))
        if not np.array_equal(states[index], states[index - 1])
    ]
    # Windows of one second, open at the end, that begin at a change hold the most.
    windows = [sum(start <= time < start + 1.0 for time in changes_s) for start in changes_s]
    return float(max(windows, default=0))


def light_on_s(shots: Sequence[Shot], shot_worst_s: float) -> np.ndarray:
    """(n,) seconds at full level that each light is on, if every shot lasts its longest."""
    return np.sum([shot.levels for shot in shots], axis=0) * shot_worst_s


def check_shots(shots: Sequence[Shot], rig: Rig, config: SafetyConfig, shot_worst_s: float) -> None:
    """Refuse a sequence that flashes too fast or keeps a light on too long.

    Args:
        shots: what is to be lit.
        rig: the lights.
        config: the limits.
        shot_worst_s: longest that one shot can last, when every deadline is used up.

    Raises:
        ConfigError: what was found and which limit it breaks, all in one message.
    """
    problems: list[LightstageError] = []
    rate = flash_rate_per_s(shots, config.light_interval_s)
    if rate > config.max_flashes_per_s:
        problems.append(
            ConfigError(
                "sequence",
                field="flash rate",
                found=f"up to {rate:g} flashes per second",
                expected=f"at most {config.max_flashes_per_s:g} (max_flashes_per_s)",
                hint="Give light_interval_s a larger value.",
            )
        )
    on_s = light_on_s(shots, shot_worst_s)
    hot = np.flatnonzero(on_s > config.max_light_on_s)
    if len(hot):
        worst = rig.lights[int(np.argmax(on_s))]
        problems.append(
            ConfigError(
                "sequence",
                field="duty",
                found=f"{len(hot)} lights over the budget, light {worst.id} ({worst.name}) up to "
                f"{on_s.max():.0f} s at full level",
                expected=f"at most {config.max_light_on_s:g} s (max_light_on_s)",
                hint="Split the sequence, or lower the cameras' deadline.",
            )
        )
    if problems:
        raise one_error(problems)
