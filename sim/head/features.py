"""Lips, open lids and ears: what a ray from inside meets more than once, moved on the grid."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from sim.head.ears import add_ears
from sim.head.eyes import open_lids
from sim.head.grid import (
    MOUTH_HALF_DEG,
    ROW_MOUTH,
    ROWS,
    face_azimuth_deg,
    smoothstep,
)

# Lip profile: rows from the mouth line (negative upward) against mm outward and mm upward.
_PROFILE_ROWS = (-11, -8, -6, -5, -4, -2.5, -1, 0, 1, 2.5, 4, 5, 6.5, 9, 12)
_PROFILE_OUT = (0, 0.2, 0.9, 1.9, 2.8, 3.3, 2.5, 0.0, 2.4, 4.0, 3.8, 2.4, 0.5, -0.8, 0)
_PROFILE_UP = (0, 0, 0, 0, -0.2, -0.5, -0.9, 0, 0.9, 0.5, 0.2, 0, 0, 0, 0)


def add_features(grid: np.ndarray) -> np.ndarray:
    """Add lips, eyeballs between open lids, and ears to the cast surface.

    Args:
        grid: (rows + 1, columns + 1, 3) mm.

    Returns:
        The same shape.
    """
    azimuth = face_azimuth_deg()
    out = _add_lips(grid, azimuth)
    out = open_lids(out)
    return add_ears(out)


def _add_lips(grid: np.ndarray, azimuth_deg: np.ndarray) -> np.ndarray:
    mouth = np.abs(azimuth_deg) / MOUTH_HALF_DEG
    taper = np.clip(1 - np.clip(mouth, 0, 1) ** 2.0, 0, 1) ** 0.85
    taper = np.maximum(taper, 0.15 * smoothstep(1.25, 0.95, mouth))
    rows = np.arange(ROWS + 1.0) - ROW_MOUTH
    out_mm = np.where(
        np.abs(rows) <= 12,
        PchipInterpolator(_PROFILE_ROWS, _PROFILE_OUT)(np.clip(rows, -11, 12)),
        0,
    )
    up_mm = np.where(
        np.abs(rows) <= 12, PchipInterpolator(_PROFILE_ROWS, _PROFILE_UP)(np.clip(rows, -11, 12)), 0
    )
    philtrum = np.exp(-0.5 * ((rows + 9.0) / 2.4) ** 2)[:, None] * (
        1.0 * np.exp(-(((mouth - 0.2) / 0.11) ** 2)) - 0.9 * np.exp(-((mouth / 0.11) ** 2))
    )
    ahead = out_mm[:, None] * taper + philtrum
    a = np.radians(azimuth_deg) * 0.8
    result = grid.copy()
    result[..., 0] += ahead * np.sin(a)
    result[..., 1] += up_mm[:, None] * taper
    result[..., 2] += ahead * np.cos(a)
    return result
