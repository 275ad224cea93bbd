"""Figures of processed sessions, and which of them stand out of the others'."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

FEWEST = 5
"""Sessions below which nothing can stand out."""
MAD_TO_SIGMA = 1.4826
"""A normal distribution's standard deviation over its median absolute deviation."""
Facts = Mapping[str, Mapping[str, Any]]


@dataclasses.dataclass(frozen=True)
class Figure:
    """One number of a session.

    Attributes:
        name: with its unit.
        stage: that reports it.
        of: the number of the stage's facts; None where there is none.
        worse: 1 where more is worse, -1 where less is.
    """

    name: str
    stage: str
    of: Callable[[Mapping[str, Any]], float | None]
    worse: int


def _number(value: Any) -> float | None:
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if plain and math.isfinite(value) else None


def _fact(name: str) -> Callable[[Mapping[str, Any]], float | None]:
    return lambda facts: _number(facts.get(name))


def _over_cameras(name: str, worst: Callable[[list[float]], float]) -> Callable[..., float | None]:
    """The worst camera's value of a fact that has one for each."""

    def read(facts: Mapping[str, Any]) -> float | None:
        value = facts.get(name)
        each = value.values() if isinstance(value, Mapping) else []
        numbers = [n for n in map(_number, each) if n is not None]
        return worst(numbers) if numbers else None

    return read


def _of_sums(name: str) -> Callable[[Mapping[str, Any]], float | None]:
    """The largest value of a fact of the sums of patterns, over cameras and patterns."""

    def read(facts: Mapping[str, Any]) -> float | None:
        cameras = facts.get("sums")
        found: list[float] = []
        for camera in cameras.values() if isinstance(cameras, Mapping) else []:
            value = camera.get(name) if isinstance(camera, Mapping) else None
            each = value.values() if isinstance(value, Mapping) else [value]
            found += [n for n in map(_number, each) if n is not None]
        return max(found) if found else None

    return read


FIGURES: tuple[Figure, ...] = (
    Figure("motion, px", "decode", _of_sums("displaced_px"), 1),
    Figure("patterns do not add up, share", "decode", _of_sums("left"), 1),
    Figure("clipped, share", "decode", _over_cameras("clipped_share_of_foreground", max), 1),
    Figure("confidence of a view", "refine", _over_cameras("mean_confidence", min), -1),
    Figure("coverage of a view", "reconstruct", _over_cameras("coverage", min), -1),
    Figure("pose residual, px", "reconstruct", _over_cameras("pose_residual_px", max), 1),
    Figure("landmark rays, mm", "register", _fact("landmark_rays_rms_mm"), 1),
    Figure("template to scan, mm", "register", _fact("template_to_scan_median_mm"), 1),
    Figure("template to scan p95, mm", "register", _fact("template_to_scan_p95_mm"), 1),
    Figure("atlas seen, share", "atlas", _fact("seen_share"), -1),
    Figure("atlas confidence", "atlas", _fact("mean_confidence"), -1),
)


def numbers(facts: Facts) -> list[float | None]:
    """The figures of a session, in the order of `FIGURES`.

    Args:
        facts: of its stages, by stage.
    """
    return [figure.of(facts.get(figure.stage, {})) for figure in FIGURES]


def robust_z(values: Sequence[float | None]) -> np.ndarray:
    """How far each value is from the median, in robust standard deviations.

    z = (x - median) / (1.4826 MAD), the modified z-score of [IglewiczHoaglin1993]. Where more than
    half of the values are the same, their mean absolute deviation times 1.2533 takes the MAD's
    place, as there.

    Args:
        values: of n sessions; None where a session has none.

    Returns:
        (n,) float64, at most 1e6 either way; 0 where there is no value, fewer than `FEWEST` have
        one, or all are the same.
    """
    found = np.array([np.nan if v is None else v for v in values], float)
    found[~np.isfinite(found)] = np.nan
    there = ~np.isnan(found)
    z = np.zeros(len(found))
    if there.sum() < FEWEST:
        return z
    # Halves, so that the largest floats have a difference.
    known = found[there] / 2
    apart = known - np.median(known)
    scale = MAD_TO_SIGMA * float(np.median(np.abs(apart)))
    largest = float(np.abs(apart).max())
    if scale == 0 and largest > 0:
        scale = 1.253314 * largest * float(np.mean(np.abs(apart / largest)))
    if scale > 0:
        with np.errstate(over="ignore"):
            z[there] = np.clip(apart / scale, -1e6, 1e6)
    return z


def standing_out(rows: Sequence[Sequence[float | None]]) -> np.ndarray:
    """How far each session's figures are on their bad side.

    Args:
        rows: `numbers` of n sessions.

    Returns:
        (n, figures) float64 robust z, above 0 where a figure is worse than the median.
    """
    out = np.zeros((len(rows), len(FIGURES)))
    for column, figure in enumerate(FIGURES):
        out[:, column] = figure.worse * robust_z([row[column] for row in rows])
    return out
