"""Skin colour by tone over people."""

from __future__ import annotations

import numpy as np

from processing.tones import ITA_NAMES, tone_of


def by_tone(true_deg: list[float], error_deg: list[float]) -> dict[str, tuple[int, float]]:
    """People and their mean error of the typology angle, degrees, by the true tone.

    Args:
        true_deg: each person's angle.
        error_deg: each person's absolute error.
    """
    groups: dict[str, list[float]] = {}
    for true, error in zip(true_deg, error_deg, strict=True):
        groups.setdefault(tone_of(true), []).append(error)
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
