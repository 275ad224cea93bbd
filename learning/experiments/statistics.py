"""Figures by seed and person: paired differences, tables, what seeds differ by."""

from __future__ import annotations

import numpy as np

from learning.bootstrap import Interval, interval


def paired(
    one: dict[tuple[int, str], float], other: dict[tuple[int, str], float]
) -> tuple[Interval, int, int]:
    """How much larger `other` is, seed by seed and person by person, where both have a figure.

    Args:
        one: figures by seed and person.
        other: the same of the setting that is compared.

    Returns:
        The interval of the differences, and how many seeds and people they are over.
    """
    both = sorted(one.keys() & other.keys())
    values, seeds, people = table({key: other[key] - one[key] for key in both})
    return interval(values), len(seeds), len(people)


def table(figures: dict[tuple[int, str], float]) -> tuple[np.ndarray, list[int], list[str]]:
    """Figures by seed and person as (seeds, people), NaN where there is none; both named."""
    seeds = sorted({seed for seed, _ in figures})
    people = sorted({person for _, person in figures})
    values = np.full((len(seeds), len(people)), np.nan)
    for (seed, person), value in figures.items():
        values[seeds.index(seed), people.index(person)] = value
    return values, seeds, people


def over_seeds(values: np.ndarray) -> float:
    """Standard deviation over seeds of the mean over people, % of the mean; NaN of one seed.

    Args:
        values: (seeds, people), NaN where there is none.
    """
    known = values[np.isfinite(values).all(axis=1)]
    if len(known) < 2:
        return float("nan")
    means = known.mean(axis=1)
    return float(100 * means.std(ddof=1) / means.mean())
