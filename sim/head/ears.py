"""Ears: a square of the grid shaped into an egg that stands off the head, with its relief."""

from __future__ import annotations

import numpy as np

from sim.head.grid import COLUMNS, ROWS, relaxed, smoothstep

# Rows about the ear's middle, columns from its front to the rim and back under it.
_ROW, _HALF_ROWS = 52.0, 24.0
_FRONT, _RIM = 35, 43
_COLUMNS = (35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46)
_BACK = (-1.0, -0.80, -0.60, -0.36, -0.10, 0.18, 0.48, 0.77, 1.0, 0.99, 0.97, 1.04)
_UNDER = (1.0, 0.72, 0.3, 0.0)
"""How much of the rim's height the columns behind it keep."""

_HALF_WIDTH_MM, _HALF_HEIGHT_MM = 17.0, 31.2
_MIDDLE_MM = (-15.0, -12.0)
_TILT_DEG = 14.0


def ear_share(points: np.ndarray) -> np.ndarray:
    """(rows + 1, columns + 1) 0..1: how much of each grid point is ear; `points` the cast grid."""
    row, column = _square()
    across = np.interp(column, _COLUMNS, _BACK)
    # The square's corners are flat on the head.
    wide = np.where(across < 0, 1.08, 1.0) * np.abs(across)
    egg = smoothstep(1.27, 1.19, (wide**3 + np.abs(row) ** 3) ** (1 / 3))
    return np.asarray(
        egg
        * smoothstep(1.06, 0.98, np.abs(row))
        * smoothstep(_FRONT - 1.0, _FRONT + 1.0, column)
        * smoothstep(_RIM + 3.0, _RIM + 2.0, column)
    ) * np.ones(points.shape[:2])


def beside_ears() -> np.ndarray:
    """(rows + 1, columns + 1) 0 on the ears, rising to 1 where the head no longer bends to them."""
    row, column = _square()
    away = np.maximum(
        (np.abs(row) - 1.15) / 0.75,
        np.maximum(_FRONT - 2.0 - column, column - _RIM - 3.0) / 8.0,
    )
    return np.asarray(smoothstep(0.0, 1.0, away))


def _square() -> tuple[np.ndarray, np.ndarray]:
    """Rows as -1 (lobe) to 1 (top), and columns counted from the middle of the face."""
    row = (_ROW - np.arange(ROWS + 1.0)) / _HALF_ROWS
    return row[:, None], np.abs(np.arange(COLUMNS + 1.0) - COLUMNS // 2)[None]


def relief_mm(across: np.ndarray, row: np.ndarray) -> np.ndarray:
    """How far the ear's outer side stands off the head.

    Args:
        across: (...) -1 at the front to 1 at the rim.
        row: (...) -1 at the lobe to 1 at the top.

    Returns:
        mm: the bowl (concha) before the rim (helix) and the ridge inside it (antihelix), the flap
        in front (tragus), the lobe below.
    """
    a, r = across, row

    def spot(centre: tuple[float, float], spread: tuple[float, float]) -> np.ndarray:
        q = ((a - centre[0]) / spread[0]) ** 2 + ((r - centre[1]) / spread[1]) ** 2
        return np.exp(-(q**1.3))

    upper = smoothstep(-0.72, -0.3, r)
    plane = (12.0 - 5.5 * (1 - upper)) * np.clip(0.5 * (a + 1), 0, 1) ** 1.15
    # Corners of the square are rounded into the egg, so the rim is a rounded square here.
    edge = (np.abs(a) ** 3 + np.abs(0.97 * r) ** 3) ** (1 / 3)
    helix = 4.6 * np.exp(-(((edge - 0.94) / 0.13) ** 2))
    helix = helix * smoothstep(-0.55, -0.2, r) * smoothstep(-1.25, -0.6, a + 0.9 * r)
    groove = -2.6 * np.exp(-(((edge - 0.70) / 0.10) ** 2)) * upper * smoothstep(0.0, 0.4, a + r)
    ring = np.hypot((a + 0.3) / 1.05, (r + 0.02) / 0.95)
    ridge = 3.2 * np.exp(-(((ring - 0.56) / 0.14) ** 2)) * smoothstep(-0.15, 0.25, a + 0.2)
    ridge = ridge * smoothstep(-0.62, -0.4, r) * smoothstep(0.75, 0.5, r)
    bowl = -9.5 * spot((-0.32, -0.06), (0.36, 0.36))
    hollow = -2.0 * spot((-0.12, 0.58), (0.30, 0.16))
    flap = 4.2 * spot((-0.74, -0.14), (0.16, 0.17)) + 2.4 * spot((-0.08, -0.52), (0.22, 0.12))
    lobe = 2.6 * spot((0.1, -0.82), (0.5, 0.22))
    return np.asarray(plane + helix + groove + ridge + bowl + hollow + flap + lobe)


def add_ears(grid: np.ndarray) -> np.ndarray:
    """Shape the ears into a grid (rows + 1, columns + 1, 3) mm; returns a new one."""
    row, column = _square()
    across = np.interp(column, _COLUMNS, _BACK)
    weight = smoothstep(1.7, 1.05, np.abs(row)) * smoothstep(_FRONT - 6, _FRONT, column)
    weight = weight * smoothstep(_RIM + 6, _RIM + 2, column)
    # Square to egg, short of its corners, where quads would flatten.
    bend = 0.62 - 0.12 * smoothstep(-0.4, 0.4, row)
    narrow = 1 + 0.14 * row
    back = _HALF_WIDTH_MM * across * np.sqrt(1 - bend * np.clip(row, -1, 1) ** 2) * narrow
    up = _HALF_HEIGHT_MM * row * np.sqrt(1 - bend * np.clip(across, -1, 1) ** 2)
    tilt = np.radians(_TILT_DEG)
    y = _MIDDLE_MM[0] + up * np.cos(tilt) - back * np.sin(tilt)
    z = _MIDDLE_MM[1] - up * np.sin(tilt) - back * np.cos(tilt)
    edge = smoothstep(1.04, 0.84, np.abs(row))
    outer = relief_mm(np.clip(across, -1, 1), np.clip(row, -1, 1))
    rim = outer[:, COLUMNS // 2 + _RIM][:, None] * np.interp(column, _COLUMNS[-4:], _UNDER)
    height = edge * np.where(column > _RIM, rim, outer)
    height = height * smoothstep(_FRONT - 0.5, _FRONT + 1, column)
    height = height * smoothstep(_RIM + 3, _RIM + 2.9, column)
    result = grid.copy()
    result[..., 0] += np.sign(grid[..., 0]) * (0.9 * height)
    # Beside the ear the grid follows the shift of the ear's own front and back.
    nearest = np.clip(column[0], _FRONT, _RIM + 3) * np.where(grid[-1, :, 0] < 0, -1, 1)
    nearest = (COLUMNS // 2 + nearest).astype(int)
    result[..., 1] += weight * (y - grid[..., 1])[:, nearest]
    result[..., 2] += weight * (z - grid[..., 2])[:, nearest] - 0.45 * height
    around = smoothstep(2.0, 1.6, np.abs(row)) * smoothstep(_FRONT - 10, _FRONT - 6, column)
    around = around * smoothstep(_RIM + 10, _RIM + 7, column)
    kept = (np.abs(row) < 0.97) & (column >= _FRONT) & (column <= _RIM + 2)
    return relaxed(result, np.where(kept, 0.0, around))
