"""Limits of light, and a sequence compared with them before a light goes on."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from lightstage.counting import counted
from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.rig import Rig
from lightstage.safety.budget import FlashCounter, worst_heat
from lightstage.sequence import Shot

BOUNDS: dict[str, tuple[float, float]] = {
    "max_flashes_per_s": (0.5, 30.0),
    "light_interval_s": (0.0, 60.0),
    "max_light_on_s": (0.1, 86_400.0),
    "max_heat": (0.01, 1.0),
    "heat_time_constant_s": (1.0, 86_400.0),
    "max_silence_s": (0.5, 60.0),
}
"""Lowest and highest value of each limit; beyond them it would be no limit, or nothing could be
lit. One change of light in a second is half a flash."""
REASONS = {
    "max_flashes_per_s": "Light that flashes more than 3 times in a second can cause epileptic "
    "seizures (WCAG 2.3.1); a value above 3 is taken with a warning.",
    "max_heat": "1 is the warmth of a light at full power for ever.",
}
"""What to know where a value is refused."""


@dataclasses.dataclass(frozen=True)
class SafetyConfig:
    """Limits for the person in the stage and for its lights.

    Attributes:
        max_flashes_per_s: flashes in any second; three is the limit below which photosensitive
            people are held to be safe [WCAG-Flashes]. A higher one is warned of at each start.
        light_interval_s: shortest time between two changes of light; a capture waits for it.
        max_light_on_s: time at full level that one light may be on in one capture.
        max_heat: how warm a light may get, as a share of what full power for ever would make it.
        heat_time_constant_s: after which a light at constant power is at 63 % of its warmth.
        max_silence_s: a capture that hangs for so long is made dark from outside.
    """

    max_flashes_per_s: float = 3.0
    light_interval_s: float = 0.4
    max_light_on_s: float = 600.0
    max_heat: float = 0.9
    heat_time_constant_s: float = 300.0
    max_silence_s: float = 10.0

    def __post_init__(self) -> None:
        """ConfigError, all in one message, on values that are no limits (`BOUNDS`)."""
        problems: list[LightstageError] = []
        for name, (low, high) in BOUNDS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                problems.append(
                    ConfigError(
                        "safety",
                        field=name,
                        found=f"{value:g}",
                        expected=f"a number from {low:g} to {high:g}",
                        hint=REASONS.get(name, ""),
                    )
                )
        if problems:
            raise one_error(problems)


def flash_rate_per_s(shots: Sequence[Shot], light_interval_s: float) -> float:
    """Most flashes in any second, whatever part of the stage is seen (FlashCounter).

    Lights change as fast as they may; the darkness before the first shot and after the last one
    belongs to the sequence.
    """
    dark = np.zeros_like(shots[0].levels)
    counter = FlashCounter(len(dark))
    for index, levels in enumerate([*(shot.levels for shot in shots), dark]):
        counter.add(index * light_interval_s, levels)
    return counter.worst_per_s


def light_on_s(shots: Sequence[Shot], shot_worst_s: float) -> np.ndarray:
    """(n,) seconds at full level that each light is on, if every shot lasts its longest."""
    return np.sum([shot.levels for shot in shots], axis=0) * shot_worst_s


def check_shots(shots: Sequence[Shot], rig: Rig, config: SafetyConfig, shot_worst_s: float) -> None:
    """Refuse a sequence that flashes too fast, or keeps a light on too long or too hot.

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
    heat = worst_heat(
        np.array([shot.levels for shot in shots]), shot_worst_s, config.heat_time_constant_s
    )
    for field, values, limit, template, limit_template in (
        ("duty", on_s, config.max_light_on_s, "{:.0f} s at full level", "{:g} s (max_light_on_s)"),
        ("heat", heat, config.max_heat, "{:.2f} of full power's warmth", "{:g} (max_heat)"),
    ):
        over = int(np.sum(values > limit))
        if not over:
            continue
        worst = rig.lights[int(np.argmax(values))]
        problems.append(
            ConfigError(
                "sequence",
                field=field,
                found=f"{counted(over, 'lamp')} over the budget, lamp {worst.id} ({worst.name}) "
                "up to " + template.format(values.max()),
                expected="at most " + limit_template.format(limit),
                hint="Split the sequence, or lower the cameras' deadline.",
            )
        )
    if problems:
        raise one_error(problems)
