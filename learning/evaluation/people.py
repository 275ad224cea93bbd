"""Figures over people: means with intervals by bootstrap, and skin colour by tone."""

from __future__ import annotations

import dataclasses

import numpy as np

from processing.tones import ITA_NAMES, tone_of

DRAWS = 2000
INTERVAL = (2.5, 97.5)
"""Percent: 95 % of the draws lie within."""
SEED = 20221


@dataclasses.dataclass(frozen=True)
class Interval:
    """A mean over people and where 95 % of bootstrap's means lie; NaN of one person."""

    mean: float
    low: float
    high: float


def interval(values: list[float]) -> Interval:
    """Mean over people, and its interval: people are drawn with replacement [Efron1979]."""
    known = np.array([v for v in values if np.isfinite(v)])
    if not known.size:
        return Interval(float("nan"), float("nan"), float("nan"))
    if known.size == 1:
        return Interval(float(known[0]), float("nan"), float("nan"))
    rng = np.random.default_rng(SEED)
    means = known[rng.integers(0, known.size, (DRAWS, known.size))].mean(axis=1)
    low, high = np.percentile(means, INTERVAL)
    return Interval(float(known.mean()), float(low), float(high))


def by_tone(true_deg: list[float], found_deg: list[float]) -> dict[str, tuple[int, float]]:
    """People and mean absolute error of the typology angle, degrees, by the true tone."""
    groups: dict[str, list[float]] = {}
    for true, found in zip(true_deg, found_deg, strict=True):
        groups.setdefault(tone_of(true), []).append(abs(found - true))
    return {
        name: (len(groups[name]), float(np.mean(groups[name])))
        for name in ITA_NAMES
        if name in groups
    }


def spread(groups: dict[str, tuple[int, float]]) -> float:
    """The worst tone's error over the best's: 1 is fair; NaN with fewer than two tones."""
    errors = [error for _, error in groups.values()]
    if len(errors) < 2:
        return float("nan")
    return float(max(errors) / max(min(errors), 1e-6))
