"""Figures over people and seeds: means and paired differences with intervals by bootstrap."""

from __future__ import annotations

import dataclasses

import numpy as np

DRAWS = 2000
PERCENT = (2.5, 97.5)
"""95 % of the draws are between these."""
SEED = 20221


@dataclasses.dataclass(frozen=True)
class Spread:
    """A mean, and where 95 % of bootstrap's means are; NaN where there is nothing to draw from."""

    mean: float
    low: float
    high: float

    @property
    def distinguished(self) -> bool:
        """Whether the interval leaves zero out; False where it is not known."""
        return bool(self.low > 0 or self.high < 0)


def spread_of(values: np.ndarray) -> Spread:
    """Mean over seeds and people, both drawn with replacement, each by itself [Efron1979].

    One seed is drawn always, and so is one person: then the interval says nothing of others.

    Args:
        values: (seeds, people); NaN where one has no figure.
    """
    known = np.isfinite(values)
    if not known.any():
        return Spread(float("nan"), float("nan"), float("nan"))
    mean = float(values[known].mean())
    if values.size == 1:
        return Spread(mean, float("nan"), float("nan"))
    rng = np.random.default_rng(SEED)
    seeds, people = values.shape
    row = rng.integers(0, seeds, (DRAWS, seeds))
    column = rng.integers(0, people, (DRAWS, people))
    drawn = values[row[:, :, None], column[:, None, :]].reshape(DRAWS, -1)
    there = np.isfinite(drawn)
    count = there.sum(axis=1)
    some = count > 0
    means = np.where(there, drawn, 0).sum(axis=1)[some] / count[some]
    low, high = np.percentile(means, PERCENT)
    return Spread(mean, float(low), float(high))


def paired(
    one: dict[tuple[int, str], float], other: dict[tuple[int, str], float]
) -> tuple[Spread, int, int]:
    """How much larger `other` is, seed by seed and person by person, where both have a figure.

    Args:
        one: figures by seed and person.
        other: the same of the setting that is compared.

    Returns:
        The spread of the differences, and how many seeds and people they are over.
    """
    both = sorted(one.keys() & other.keys())
    values, seeds, people = table({key: other[key] - one[key] for key in both})
    return spread_of(values), len(seeds), len(people)


def table(figures: dict[tuple[int, str], float]) -> tuple[np.ndarray, list[int], list[str]]:
    """Figures by seed and person as (seeds, people), NaN where there is none; both named."""
    seeds = sorted({seed for seed, _ in figures})
    people = sorted({person for _, person in figures})
    values = np.full((len(seeds), len(people)), np.nan)
    for (seed, person), value in figures.items():
        values[seeds.index(seed), people.index(person)] = value
    return values, seeds, people


def over_seeds(values: np.ndarray) -> float:
    """Standard deviation over seeds of the mean over people, % of the mean; NaN of one seed."""
    known = values[np.isfinite(values).all(axis=1)]
    if len(known) < 2:
        return float("nan")
    means = known.mean(axis=1)
    return float(100 * means.std(ddof=1) / means.mean())
