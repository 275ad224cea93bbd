"""How often lights flash, how hot they get: pure figures, the same for a plan and for a capture."""

from __future__ import annotations

import numpy as np

CHANGE = 0.1
"""Share of the highest luminance by which two opposing changes make a flash [WCAG-Flashes]."""
SECOND = 1.0 + 1e-9
"""Both ends of a second belong to it; the rest is for the rounding of times."""


class FlashCounter:
    """Counts changes of light so that no group of lights can flash more often.

    A general flash is a pair of opposing changes of relative luminance, each of at least a tenth
    of the highest one [WCAG-Flashes]. Which part of the stage somebody looks at is not known, and
    two groups of lights can flash in turn where their sum stays the same. So every state in which
    any one lamp differs from the state counted last by half a tenth (of the highest level so far)
    counts as a change, and every change as opposed to the one before: if the mean of some group
    moves by a tenth between two moments, one of its lamps does so too, and then differs by half
    of that from what was counted before, at one of both. So there are at most half as many flashes
    as counted changes, in whatever group. The standard's exemptions (both states brighter than
    0.8, small areas) are not used.
    """

    def __init__(self, light_count: int) -> None:
        self._counted = np.zeros(light_count)
        self._highest = 0.0
        self._times_s: list[float] = []
        self.worst_per_s = 0.0
        """Most flashes in any second so far."""

    def add(self, time_s: float, levels: np.ndarray) -> None:
        """Note that (n,) levels are lit from `time_s` on; times never go back."""
        self._highest = max(self._highest, float(np.max(levels, initial=0.0)))
        if not self._is_change(levels):
            return
        self._counted = np.array(levels, float)
        self._times_s = [t for t in self._times_s if time_s - t <= SECOND] + [time_s]
        self.worst_per_s = max(self.worst_per_s, len(self._times_s) / 2)

    def wait_s(self, time_s: float, levels: np.ndarray, max_per_s: float) -> float:
        """Seconds from `time_s` until (n,) levels may be lit with at most `max_per_s` flashes."""
        highest = max(self._highest, float(np.max(levels, initial=0.0)))
        if not self._differs(levels, highest):
            return 0.0
        allowed = max(1, int(2 * max_per_s))
        if len(self._times_s) < allowed:
            return 0.0
        return max(0.0, self._times_s[-allowed] + 1.001 - time_s)

    def _is_change(self, levels: np.ndarray) -> bool:
        return self._differs(levels, self._highest)

    def _differs(self, levels: np.ndarray, highest: float) -> bool:
        difference = float(np.max(np.abs(levels - self._counted), initial=0.0))
        return difference > 0 and difference >= CHANGE / 2 * highest


def heat_after(
    heat: np.ndarray, levels: np.ndarray, seconds: float, time_constant_s: float
) -> np.ndarray:
    """Heating of lights, as a share of what each would reach at full power after a long time.

    A light is one lump of heat (lumped capacitance [Incropera2007]): it takes up power in
    proportion to its level and gives it off in proportion to how much warmer it is than the room.

    Args:
        heat: (n,) now, 0 cold, 1 as at full power for ever.
        levels: (n,) in 0..1, for `seconds`.
        seconds: from now.
        time_constant_s: after which 63 % of the way is done.
    """
    return levels + (heat - levels) * np.exp(-seconds / time_constant_s)


def seconds_until(
    heat: np.ndarray, levels: np.ndarray, limit: float, time_constant_s: float
) -> np.ndarray:
    """(n,) seconds until each light's heat passes the limit; infinite where it never does."""
    left = np.full(np.shape(levels), np.inf)
    hotter = levels > limit
    over = np.maximum(levels - heat, 0.0)[hotter] / (levels[hotter] - limit)
    left[hotter] = time_constant_s * np.log(np.maximum(over, 1.0))
    return left


def worst_heat(states: np.ndarray, longest_s: float, time_constant_s: float) -> np.ndarray:
    """(n,) highest heat that each light can reach in a sequence, from cold.

    A state lasts at most `longest_s`, and may be over at once: a light never cools more in between
    than it has to, and heats as long as it can.

    Args:
        states: (k, n) levels in order.
        longest_s: of a state.
        time_constant_s: as in `heat_after`.
    """
    heat = np.zeros(states.shape[1])
    for levels in states:
        heat = np.maximum(heat, heat_after(heat, levels, longest_s, time_constant_s))
    return heat


class Spent:
    """What lights have spent of their time and warmth while a capture runs.

    Args:
        light_count: lights, dark and cold at the start.
        time_constant_s: as in `heat_after`.

    Attributes:
        levels: (n,) lit now.
        on_s: (n,) seconds at full level until the last `advance`.
        heat: (n,) warmth then.
    """

    def __init__(self, light_count: int, time_constant_s: float) -> None:
        self.levels = np.zeros(light_count)
        self.on_s = np.zeros(light_count)
        self.heat = np.zeros(light_count)
        self._time_constant_s = time_constant_s
        self._now_s = -np.inf

    def advance(self, now_s: float) -> None:
        """Count what was lit until now; a time before the last one counts as that one."""
        passed_s = max(0.0, now_s - self._now_s) if np.isfinite(self._now_s) else 0.0
        self._now_s = max(now_s, self._now_s)
        self.on_s = self.on_s + self.levels * passed_s
        self.heat = heat_after(self.heat, self.levels, passed_s, self._time_constant_s)

    def light(self, now_s: float, levels: np.ndarray) -> None:
        """From now on (n,) levels are lit."""
        self.advance(now_s)
        self.levels = np.array(levels, float)

    def allowed_s(self, levels: np.ndarray, max_on_s: float, max_heat: float) -> np.ndarray:
        """(n,) seconds for which each light may have these levels from the last `advance` on."""
        on = levels > 0
        allowed = seconds_until(self.heat, levels, max_heat, self._time_constant_s)
        allowed[on] = np.minimum(allowed[on], (max_on_s - self.on_s[on]) / levels[on])
        return np.maximum(allowed, 0.0)
