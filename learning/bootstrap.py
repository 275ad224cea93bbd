"""Means over people, or over seeds and people, with 95 % intervals by bootstrap [Efron1979]."""

from __future__ import annotations

import dataclasses

import numpy as np

DRAWS = 2000
PERCENT = (2.5, 97.5)
"""95 % of the draws are between these."""
SEED = 20221


@dataclasses.dataclass(frozen=True)
class Interval:
    """A mean, and where 95 % of bootstrap's means are; NaN where there is nothing to draw from."""

    mean: float
    low: float
    high: float

    @property
    def distinguished(self) -> bool:
        """Whether the interval leaves zero out; False where it is not known."""
        return bool(self.low > 0 or self.high < 0)


def interval(values: np.ndarray | list[float]) -> Interval:
    """Mean over seeds and people, both drawn with replacement, each by itself.

    One seed is drawn always, and so is one person: then the interval does not describe others.

    Args:
        values: (people,), or (seeds, people); NaN where one has no figure.
    """
    table = np.atleast_2d(np.asarray(values, float))
    known = np.isfinite(table)
    if not known.any():
        return Interval(float("nan"), float("nan"), float("nan"))
    mean = float(table[known].mean())
    if known.sum() == 1:
        return Interval(mean, float("nan"), float("nan"))
    rng = np.random.default_rng(SEED)
    seeds, people = table.shape
    row = rng.integers(0, seeds, (DRAWS, seeds))
    column = rng.integers(0, people, (DRAWS, people))
    drawn = table[row[:, :, None], column[:, None, :]].reshape(DRAWS, -1)
    there = np.isfinite(drawn)
    count = there.sum(axis=1)
    some = count > 0
    means = np.where(there, drawn, 0).sum(axis=1)[some] / count[some]
    low, high = np.percentile(means, PERCENT)
    return Interval(mean, float(low), float(high))
