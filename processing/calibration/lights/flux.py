"""How strong lamps are, from their highlights in a mirror ball."""

from __future__ import annotations

import dataclasses

import numpy as np

LEAST_FREE = 10
"""Highlights beyond those that determine lamps' and photographs' levels, for their error."""


@dataclasses.dataclass(frozen=True)
class Flux:
    """n highlights' light, put on a scale of the lamps' radiant intensity.

    Attributes:
        lamp: (n,) which lamp.
        group: (n,) which photograph: of one scale that is not known.
        intensity: (n, 3) of each channel; NaN where it clipped.
    """

    lamp: np.ndarray
    group: np.ndarray
    intensity: np.ndarray


def intensities(flux: Flux, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lamps' radiant intensities from their highlights, relative to each other.

    A mirror ball sends a lamp's light into all directions alike, so each highlight measures the
    same of its lamp but for its photograph's scale, and for sampling: their median counts.

    Args:
        flux: the highlights'.
        count: of lamps.

    Returns:
        (count, 3) natural logarithms, median 0 in each channel; NaN where unknown. (count,) their
        standard errors; infinite where unknown. All are unknown where hardly a lamp is seen twice,
        as nothing then shows how far one highlight is off.
    """
    usable = np.isfinite(flux.intensity).all(axis=1) & (flux.intensity > 0).all(axis=1)
    lamp, group = flux.lamp[usable], flux.group[usable]
    log = np.log(flux.intensity[usable])
    level = np.full((count, 3), np.nan)
    sigma = np.full(count, np.inf)
    if not len(lamp):
        return level, sigma
    of_lamp, of_group = np.zeros((count, 3)), np.zeros((group.max() + 1, 3))
    for _ in range(30):
        of_group = _medians(log - of_lamp[lamp], group, len(of_group))
        of_lamp = _medians(log - of_group[group], lamp, count)
    seen = np.bincount(lamp, minlength=count)
    spread_ = _spread(log - of_lamp[lamp] - of_group[group], lamp, group, seen)
    if np.isfinite(spread_):
        level[seen > 0] = of_lamp[seen > 0] - np.median(of_lamp[seen > 0], axis=0)
        sigma[seen > 0] = 1.25 * max(spread_, 1e-3) / np.sqrt(seen[seen > 0])
    return level, sigma


def _spread(left: np.ndarray, lamp: np.ndarray, group: np.ndarray, seen: np.ndarray) -> float:
    """Standard deviation of one highlight's logarithm; infinite where there are too few.

    A lamp's only highlight fits itself, so that lamps count which were seen at least twice.
    """
    twice = seen[lamp] > 1
    fitted = len(np.unique(lamp[twice])) + len(np.unique(group[twice])) - 1
    free = int(twice.sum()) - fitted
    if free < LEAST_FREE:
        return float(np.inf)
    shrunk = np.sqrt(free / twice.sum())
    return 1.4826 * float(np.median(np.abs(left[twice]))) / shrunk


def _medians(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) median of each group's rows; 0 where it has none."""
    out = np.zeros((count, values.shape[1]))
    order = np.argsort(group, kind="stable")
    ends = np.cumsum(np.bincount(group, minlength=count))
    for index, end in enumerate(ends):
        rows = order[ends[index - 1] if index else 0 : end]
        if len(rows):
            out[index] = np.median(values[rows], axis=0)
    return out
