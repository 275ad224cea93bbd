"""Lips, open lids and ears: what a ray from inside meets more than once, moved on the grid."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from sim.head_grid import (
    COLUMNS,
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
_PROFILE_OUT = (0, 0.1, 0.8, 1.9, 2.7, 3.7, 2.4, -4.5, 2.2, 4.3, 4.0, 2.4, 0.2, -2.0, 0)
_PROFILE_UP = (0, 0, 0, 0, -0.2, -0.6, -0.9, 0, 0.9, 0.5, 0.2, 0, 0, 0, 0)

# The ear on the grid: rows about its middle, columns from its front to the rim and back under it.
_EAR_ROW, _EAR_HALF_ROWS = 52.0, 24.0
_EAR_FRONT, _EAR_RIM = 35, 43
_EAR_COLUMNS = (35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46)
_EAR_BACK = (-1.0, -0.78, -0.58, -0.34, -0.06, 0.26, 0.56, 0.82, 1.0, 1.0, 1.0, 1.12)
_EAR_OUT = (0.0, 2.6, -1.0, -2.2, 0.6, 6.6, 8.0, 11.5, 11.0, 7.0, 2.5, 0.0)
_LOBE_OUT = (0.0, 1.2, 2.2, 3.2, 4.2, 5.0, 5.6, 6.0, 5.6, 3.6, 1.4, 0.0)


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
        part = np.array([0.09, 0.3, 0.5, 0.7, 0.91])[:, None, None]
        place = lids[:1] * (1 - part) + lids[-1:] * part
        offset = place - centre
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        pupil = centre + np.array([0, 0.5, EYE_RADIUS_MM])
        cornea = 0.8 * np.exp(-((np.linalg.norm(place - pupil, axis=-1, keepdims=True) / 5.5) ** 4))
        w = weight[columns][None, :, None]
        ball = centre + offset / distance * (EYE_RADIUS_MM + cornea)
        result[inner, columns] = w * ball + (1 - w) * grid[inner, columns]
        # Crease of the upper lid.
        rows = np.arange(ROWS + 1)
        crease = np.exp(-0.5 * ((rows - ROW_LID_UP + 4.0) / 1.0) ** 2)[:, None] * weight[columns]
        result[:, columns, 2] -= 1.3 * crease
    return result


def ear_share(points: np.ndarray) -> np.ndarray:
    """(rows + 1, columns + 1) 0..1: how much of each grid point is ear; `points` the cast grid."""
    row, column = _ear_square()
    return np.asarray(
        smoothstep(1.12, 0.98, np.abs(row))
        * smoothstep(_EAR_FRONT - 1.0, _EAR_FRONT + 1.0, column)
        * smoothstep(_EAR_RIM + 3.0, _EAR_RIM + 2.0, column)
    ) * np.ones(points.shape[:2])


def _ear_square() -> tuple[np.ndarray, np.ndarray]:
    """Rows as -1 (lobe) to 1 (top), and columns counted from the middle of the face."""
    row = (_EAR_ROW - np.arange(ROWS + 1.0)) / _EAR_HALF_ROWS
    return row[:, None], np.abs(np.arange(COLUMNS + 1.0) - COLUMNS // 2)[None]


def _add_ears(grid: np.ndarray) -> np.ndarray:
    """Shape a square of the grid into an egg-shaped sheet that stands off the head."""
    row, column = _ear_square()
    across = np.interp(column, _EAR_COLUMNS, _EAR_BACK)
    weight = smoothstep(1.7, 1.05, np.abs(row)) * smoothstep(_EAR_FRONT - 6, _EAR_FRONT, column)
    weight = weight * smoothstep(_EAR_RIM + 6, _EAR_RIM + 2, column)
    # Square to disc, short of its corners, where quads would flatten.
    bend = 0.3 + 0.18 * smoothstep(-0.4, 0.4, row)
    back = 16.5 * across * np.sqrt(1 - bend * np.clip(row, -1, 1) ** 2) * (1 + 0.12 * row)
    up = 31.0 * row * np.sqrt(1 - bend * np.clip(across, -1, 1) ** 2)
    tilt = np.radians(16.0)
    y = -14.0 + up * np.cos(tilt) - back * np.sin(tilt)
    z = -11.0 - up * np.sin(tilt) - back * np.cos(tilt)
    edge = smoothstep(1.05, 0.86, np.abs(row))
    upper = PchipInterpolator(_EAR_COLUMNS, _EAR_OUT)(np.clip(column, _EAR_FRONT, _EAR_RIM + 3))
    lobe = PchipInterpolator(_EAR_COLUMNS, _LOBE_OUT)(np.clip(column, _EAR_FRONT, _EAR_RIM + 3))
    out_mm = lobe + (upper - lobe) * smoothstep(-0.85, -0.3, row)
    out_mm = out_mm * (1 - 0.4 * smoothstep(0.2, 1.0, row))
    rim = 2.0 * np.exp(-(((np.abs(row) - 0.84) / 0.10) ** 2)) * (row > 0)
    height = edge * (out_mm + rim * smoothstep(_EAR_FRONT + 1, _EAR_RIM - 2, column))
    height = height * smoothstep(_EAR_FRONT - 0.5, _EAR_FRONT + 1, column)
    height = height * smoothstep(_EAR_RIM + 3, _EAR_RIM + 2.9, column)
    result = grid.copy()
    result[..., 0] += np.sign(grid[..., 0]) * (0.9 * height)
    # Beside the ear the grid follows the shift of the ear's own front and back.
    nearest = np.clip(column[0], _EAR_FRONT, _EAR_RIM + 3) * np.where(grid[-1, :, 0] < 0, -1, 1)
    nearest = (COLUMNS // 2 + nearest).astype(int)
    result[..., 1] += weight * (y - grid[..., 1])[:, nearest]
    result[..., 2] += weight * (z - grid[..., 2])[:, nearest] - 0.45 * height
    return result
