"""Lips, open lids and ears: what a ray from inside meets more than once, moved on the grid."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from sim.head_grid import (
    EYE_AZIMUTH_DEG,
    EYE_HALF_DEG,
    MOUTH_HALF_DEG,
    ROW_LID_LOW,
    ROW_LID_UP,
    ROW_MOUTH,
    ROWS,
    face_azimuth_deg,
    smoothstep,
)
from sim.head_shape import EYE_CENTRE_MM, EYE_RADIUS_MM

# Lip profile: rows from the mouth line (negative upward) against mm outward and mm upward.
_PROFILE_ROWS = (-11, -8, -6, -5, -4, -2.5, -1, 0, 1, 2.5, 4, 5, 6.5, 9, 12)
_PROFILE_OUT = (0, 0.2, 0.9, 1.7, 2.2, 2.6, 1.3, -5.0, 1.6, 3.6, 3.4, 2.2, 0.4, -1.6, 0)
_PROFILE_UP = (0, 0, 0, 0, -0.2, -0.6, -0.9, 0, 0.9, 0.5, 0.2, 0, 0, 0, 0)


def add_features(grid: np.ndarray) -> np.ndarray:
    """Add lips, eyeballs between open lids, and ears to the cast surface.

    Args:
        grid: (rows + 1, columns + 1, 3) mm.

    Returns:
        The same shape.
    """
    azimuth = face_azimuth_deg()
    out = _add_lips(grid, azimuth)
    out = _open_lids(out, azimuth)
    return _add_ears(out)


def _add_lips(grid: np.ndarray, azimuth_deg: np.ndarray) -> np.ndarray:
    mouth = np.abs(azimuth_deg) / MOUTH_HALF_DEG
    taper = np.clip(1 - np.clip(mouth, 0, 1) ** 2.4, 0, 1) ** 0.75
    taper = np.maximum(taper, 0.22 * smoothstep(1.5, 0.95, mouth))
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


def _open_lids(grid: np.ndarray, azimuth_deg: np.ndarray) -> np.ndarray:
    eye = (np.abs(azimuth_deg) - EYE_AZIMUTH_DEG) / EYE_HALF_DEG
    result = grid.copy()
    weight = smoothstep(1.02, 0.8, np.abs(eye))
    for side in (-1.0, 1.0):
        centre = EYE_CENTRE_MM * (side, 1, 1)
        columns = np.flatnonzero((np.sign(azimuth_deg) == side) & (weight > 0))
        inner = slice(ROW_LID_UP + 1, ROW_LID_LOW)
        lids = grid[ROW_LID_UP : ROW_LID_LOW + 1, columns]
        # The rows next to the margins go to its foot, so that the lid's edge is steep.
        part = np.array([0.06, 0.3, 0.5, 0.7, 0.94])[:, None, None]
        place = lids[:1] * (1 - part) + lids[-1:] * part
        offset = place - centre
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        pupil = centre + (0, 0.5, EYE_RADIUS_MM)
        cornea = 0.8 * np.exp(-((np.linalg.norm(place - pupil, axis=-1, keepdims=True) / 5.5) ** 4))
        w = weight[columns][None, :, None]
        ball = centre + offset / distance * (EYE_RADIUS_MM + cornea)
        result[inner, columns] = w * ball + (1 - w) * grid[inner, columns]
        # Crease of the upper lid.
        rows = np.arange(ROWS + 1)
        crease = np.exp(-0.5 * ((rows - ROW_LID_UP + 4.0) / 1.0) ** 2)[:, None] * weight[columns]
        result[:, columns, 2] -= 1.3 * crease
    return result


def _add_ears(grid: np.ndarray) -> np.ndarray:
    tilt = np.radians(14.0)
    dy, dz = grid[..., 1] + 14.0, grid[..., 2] + 13.0
    up = (dy * np.cos(tilt) - dz * np.sin(tilt)) / 31.0
    back = (-dz * np.cos(tilt) - dy * np.sin(tilt)) / (16.0 + 3.0 * np.clip(up, -1, 1))
    radius = np.hypot(up, back)
    sheet = smoothstep(1.12, 0.86, radius)
    rise = 2.0 + 13.0 * smoothstep(-0.9, 0.5, back)
    rim = 2.5 * np.exp(-(((radius - 0.84) / 0.13) ** 2)) * smoothstep(-0.8, -0.2, back + 0.5 * up)
    concha = 8.0 * np.exp(-((back / 0.45) ** 2) - ((up + 0.05) / 0.42) ** 2)
    height = sheet * (rise + rim - concha)
    result = grid.copy()
    result[..., 0] += np.sign(grid[..., 0]) * 0.85 * height
    result[..., 2] -= 0.5 * height
    return result
