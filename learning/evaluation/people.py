"""Skin colour by tone over people."""

from __future__ import annotations

import numpy as np

from processing.tones import ITA_NAMES, tone_of


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
