"""How warm a capture's lamps are, by its journal, against the limits that the capture keeps."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from lightstage.errors import ConfigError
from lightstage.operator.words import number_of, text_of
from lightstage.safety import SafetyConfig
from lightstage.safety.budget import Spent

NEAR = 0.8
"""Share of a limit from which the page warns."""


class Budget(NamedTuple):
    """How much of the limits is used by the lamp that is nearest to each of them.

    Attributes:
        heat: heat of the warmest lamp; 1 is what lasting full power would give.
        max_heat: the largest heat that is allowed.
        on_s: of the lamp that was lit longest, seconds at full level.
        max_on_s: the longest time that is allowed in one capture.
    """

    heat: float
    max_heat: float
    on_s: float
    max_on_s: float

    @property
    def near(self) -> bool:
        """Whether one of the limits is near."""
        return self.heat > NEAR * self.max_heat or self.on_s > NEAR * self.max_on_s


class Warmth:
    """Counts heat and time as the capture does (`lightstage.safety`), from the journal's lines.

    A lamp counts as lit until a line states that it is dark, so the figures are upper bounds.
    """

    def __init__(self) -> None:
        self._spent: Spent | None = None
        self._limits = SafetyConfig()

    def receive(self, line: Mapping[str, Any], lit: bool) -> None:
        """Take up a line.

        Args:
            line: of the journal; a field that is missing or wrong changes nothing.
            lit: whether a pattern is lit after it.
        """
        event = text_of(line, "event")
        if event in ("begin", "resume"):
            config = line.get("config")
            safety = config.get("safety") if isinstance(config, dict) else None
            self._limits = _limits(safety if isinstance(safety, dict) else {})
            self._spent = None  # each capture begins with cold lamps
        now_s = _seconds(text_of(line, "time_utc"))
        if now_s is None:
            return
        levels = levels_of(line) if event == "lit" else None
        if levels is not None and self._spent is None:
            self._spent = Spent(len(levels), self._limits.heat_time_constant_s)
        if self._spent is None:
            return
        if levels is not None and len(levels) == len(self._spent.levels):
            self._spent.light(now_s, levels)
        elif not lit:
            self._spent.light(now_s, np.zeros_like(self._spent.levels))

    def budget(self, now: datetime.datetime) -> Budget | None:
        """What is used at a moment; None before the first light."""
        if self._spent is None:
            return None
        self._spent.advance(now.timestamp())
        return Budget(
            float(self._spent.heat.max()),
            self._limits.max_heat,
            float(self._spent.on_s.max()),
            self._limits.max_light_on_s,
        )


def _limits(safety: Mapping[str, Any]) -> SafetyConfig:
    values = {
        name: value
        for name in ("max_heat", "max_light_on_s", "heat_time_constant_s")
        if (value := number_of(safety, name)) is not None and value > 0
    }
    try:
        return SafetyConfig(**values)
    except ConfigError:
        return SafetyConfig()


def _seconds(text: str) -> float | None:
    try:
        return datetime.datetime.fromisoformat(text).timestamp()
    except ValueError:
        return None


def levels_of(line: Mapping[str, Any]) -> np.ndarray | None:
    """(n,) levels in 0..1 that a line of the journal has; None where it has none."""
    value = line.get("levels")
    if not isinstance(value, list) or not value:
        return None
    levels = [number_of({"level": each}, "level") for each in value]
    known = [each for each in levels if each is not None and 0 <= each <= 1]
    return np.array(known) if len(known) == len(value) else None
