"""A sensor's noise from one photograph: the lower edge of its cells' variances."""

from __future__ import annotations

import math

import numpy as np

LINE_SLACK = 1.15
"""A cell is held to be without detail up to this many times the noise's line."""
DIFFERENCE_GAIN = 6.0
"""Variance of a second difference of independent values, each of variance 1."""
BIN_CELLS = 20
MIN_PAIRS = 16
"""A variance from fewer pairs has no weight alone: cells of like level are taken together."""


def fit_noise(level: np.ndarray, variance: np.ndarray, pairs: int = 10_000) -> np.ndarray:
    """Photon transfer: variance = a + b level, along the lower edge of the cells.

    Detail adds to a cell's variance and never takes away; so cells above the line are left out,
    round by round.

    Args:
        level: (...) mean of cells.
        variance: (...) of a pixel in them.
        pairs: of pixels from which each variance was taken; it is that uncertain.

    Returns:
        (2,) a and b, at least 0.
    """
    x, y = np.ravel(level).astype(float), np.ravel(variance).astype(float)
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    if not len(x) or not y.any():
        return np.zeros(2)
    if pairs < MIN_PAIRS:
        x, y, pairs = _together(x, y, pairs)
        keep = np.ones(len(x), bool)
    else:
        keep = _lower(x, y)
    slack = max(LINE_SLACK, 1.0 + 2.5 * math.sqrt(2.0 / pairs))
    line = np.zeros(2)
    for _ in range(12):
        weight = 1.0 / np.maximum(y[keep], 1e-3 * y[keep].max() + 1e-300)
        line = _line(x[keep], y[keep], weight)
        inside = y <= slack * (line[0] + line[1] * np.maximum(x, 0.0)) + 1e-300
        if inside.sum() < max(8, len(x) // 20) or (inside == keep).all():
            break
        keep = inside
    return line


def _together(x: np.ndarray, y: np.ndarray, pairs: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Level and variance of cells of like level; their middle is little moved by detail."""
    size = -(-4 * MIN_PAIRS // pairs)
    parts = np.array_split(np.argsort(x, kind="stable"), max(len(x) // size, 1))
    # The median of a mean of squared normal values against its mean, by Wilson and Hilferty.
    middle = (1 - 2 / (9 * pairs)) ** 3
    levels = np.array([np.median(x[part]) for part in parts])
    return levels, np.array([np.median(y[part]) / middle for part in parts]), pairs * size


def _lower(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) bool, the lower quarter of the cells among neighbours in level: where a fit begins."""
    keep = np.zeros(len(x), bool)
    for part in np.array_split(np.argsort(x, kind="stable"), max(len(x) // BIN_CELLS, 1)):
        keep[part[y[part] <= np.quantile(y[part], 0.25)]] = True
    return keep


def _line(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(2,) weighted straight line with neither part negative."""
    total = weight.sum()
    mean_x, mean_y = (weight * x).sum() / total, (weight * y).sum() / total
    spread = (weight * (x - mean_x) ** 2).sum()
    slope = (weight * (x - mean_x) * (y - mean_y)).sum() / spread if spread > 0 else 0.0
    slope = max(slope, 0.0)
    start = mean_y - slope * mean_x
    if start < 0:
        squares = (weight * x * x).sum()
        return np.array([0.0, max((weight * x * y).sum() / squares, 0.0) if squares > 0 else 0.0])
    return np.array([start, slope])
