"""The readings' noise, from the photographs themselves.

A gradient and its complement sum to `full`, whatever the face: what is left is the noise of three
readings. Its variance over brightness is the photon transfer curve: a line whose height without
light is the noise of reading, and whose slope is that of photons [Janesick2007].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np

from lightstage.patterns import complement
from processing.refinement.joint import Noise

BINS = 12
LEAST_PIXELS = 100
"""Least number of pixels of a bin of brightness."""
LEAST = 1e-4
"""A noise below this is not distinct from rounding to half floats."""
NORMAL_MAD = 1.4826
"""A normal distribution's standard deviation over its median absolute deviation."""
MIDDLE = 0.25
"""A reading of a typical face, at which two noises are compared."""


def times_as_noisy(found: Noise, other: Noise) -> float:
    """By what factor the variance of a typical reading is above that of another noise."""
    shot2, model2 = found.sensor**2, (found.model * MIDDLE) ** 2
    theirs = other.sensor**2 * (other.floor + MIDDLE) + (other.model * MIDDLE) ** 2
    return (shot2 * (found.floor + MIDDLE) + model2) / theirs


def measured_noise(
    readings: Sequence[np.ndarray],
    patterns: Sequence[str],
    photographed: Sequence[Collection[str]],
    assumed: Noise,
) -> tuple[Noise, bool]:
    """Noise as the photographs have it.

    Args:
        readings: of each view, (n, P, 3); 0 where not usable.
        patterns: P names.
        photographed: of each view, those that its camera took; others were made of these, and have
            no noise of their own.
        assumed: what no photograph shows: the model's, and all of it where nothing is measured.

    Returns:
        The noise, and whether it was measured.
    """
    both = zip(readings, photographed, strict=True)
    bins = [curve for rgb, own in both for curve in transfer(rgb, patterns, own)]
    if not bins:
        return assumed, False
    level, variance = np.concatenate(bins).T
    # Relative errors are what is alike: a dark bin must count as a bright one does.
    rows = np.stack([np.ones(len(level)), level], axis=1)
    weight = np.ones(len(level))
    floor = slope = 0.0
    for _ in range(8):
        floor, slope = _line(rows, variance, weight)
        weight = 1 / np.maximum(floor + slope * level, LEAST**2) ** 2
    shot2 = max(slope, LEAST**2)
    found = dataclasses.replace(
        assumed, sensor=float(np.sqrt(shot2)), floor=float(max(floor, LEAST**2) / shot2)
    )
    return found, True


def _line(rows: np.ndarray, variance: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """Height and slope, neither below 0, by least squares."""
    normal, right = (rows.T * weight) @ rows, (rows.T * weight) @ variance
    both = np.linalg.lstsq(normal, right, rcond=None)[0]
    if (both >= 0).all():
        return float(both[0]), float(both[1])
    alone = np.maximum(right / np.maximum(np.diag(normal), 1e-300), 0)
    # Of the two lines with one of the numbers 0, the nearer one.
    lines = [(float(alone[0]), 0.0), (0.0, float(alone[1]))]
    return min(lines, key=lambda line: float(weight @ (rows @ line - variance) ** 2))


def transfer(
    rgb: np.ndarray, patterns: Sequence[str], photographed: Collection[str]
) -> list[np.ndarray]:
    """Points of one view's photon transfer curve.

    Returns:
        Of each pair of patterns that sum to a `full`, (b, 2): a reading, and its noise's variance.
    """
    places = {name: k for k, name in enumerate(patterns)}
    out = []
    for first, number in places.items():
        second, whole = complement(first), "full" + "".join(first.partition("@")[1:])
        three = (first, second, whole)
        if second is None or not all(name in places and name in photographed for name in three):
            continue
        if number > places[second]:
            continue
        one, other, both = (rgb[:, places[str(name)]].astype(float) for name in three)
        # The three readings' levels sum to twice that of `full`.
        level, left = both.ravel(), (both - one - other).ravel()
        good = np.isfinite(left) & (level > 0)
        order = np.argsort(level[good])
        points = []
        for part in np.array_split(order, BINS):
            if len(part) < LEAST_PIXELS:
                continue
            some = left[good][part]
            spread = NORMAL_MAD * float(np.median(np.abs(some - np.median(some))))
            # Three readings' noise: 3 floor + slope 2 level = 3 (floor + slope 2/3 level).
            points.append((2 / 3 * float(level[good][part].mean()), spread**2 / 3))
        if points:
            out.append(np.array(points))
    return out
