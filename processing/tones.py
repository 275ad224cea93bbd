"""Skin's tone by its colour: the individual typology angle and its six groups [Chardon1991]."""

from __future__ import annotations

import numpy as np

from processing.colour_difference import lab_from_linear

ITA_BOUNDS_DEG = (55.0, 41.0, 28.0, 10.0, -30.0)
"""Least angle of the groups from very light to brown; below is dark."""
ITA_NAMES = ("very light", "light", "intermediate", "tan", "brown", "dark")
LEAST = 1e-12


def ita_deg(albedo: np.ndarray) -> float:
    """Individual typology angle of a skin's mean colour, degrees [Chardon1991].

    Args:
        albedo: (n, 3) linear sRGB.

    Returns:
        arctan((L* - 50) / b*), light skin above, dark skin below.
    """
    lab = lab_from_linear(np.maximum(albedo.reshape(-1, 3).mean(axis=0), 0))
    # Skin is yellower than grey: where one is not, the angle ends upright.
    return float(np.degrees(np.arctan2(lab[0] - 50, max(float(lab[2]), LEAST))))


def tone_of(angle_deg: float) -> str:
    """The group of an individual typology angle."""
    for least, name in zip(ITA_BOUNDS_DEG, ITA_NAMES, strict=False):
        if angle_deg > least:
            return name
    return ITA_NAMES[-1]
