"""Landmarks that all others contradict: found before they bend the mesh."""

from __future__ import annotations

import numpy as np


def contradicted(
    gaps: np.ndarray, reach: np.ndarray, least_mm: float, times_typical: float
) -> np.ndarray:
    """Landmarks that are elsewhere than the plate, held by all others, predicts.

    A plate under independent forces is a Gaussian process whose covariance is its response, so what
    the others predict for one landmark has a closed form [Rasmussen2006] (5.4.2). The worst
    is taken out and the rest tested again, until none is left that is an outlier: a wrong landmark
    makes its neighbours seem wrong too.

    Args:
        gaps: (k, 3) mm from each landmark's vertex, with no landmark pulling, to the landmark.
        reach: (k, k) mm^-2, response of each one's vertex to a unit force at each other's, with
            one over a landmark's own pull added on the diagonal.
        least_mm: prediction errors below are never taken for wrong.
        times_typical: how many times the median error, each over its expected size, is an outlier.

    Returns:
        (k,) bool; never more than a quarter of them.
    """
    wrong = np.zeros(len(gaps), bool)
    while wrong.sum() < len(gaps) // 4:
        kept = np.flatnonzero(~wrong)
        if len(kept) < 5:
            break
        inverse = np.linalg.inv(reach[np.ix_(kept, kept)])
        spread = 1 / np.maximum(np.diag(inverse), 1e-300)
        error = np.linalg.norm(inverse @ gaps[kept], axis=1) * spread
        unusual = error / np.sqrt(spread)
        suspect = (error > least_mm) & (unusual > times_typical * np.median(unusual))
        if not suspect.any():
            break
        wrong[kept[np.argmax(np.where(suspect, unusual, 0))]] = True
    return wrong
