"""Where the head's vertices lie: a regular grid of rays whose rows follow eyelids and lips.

The tile's rows run from the scalp to the neck and its columns around the head, with the seam at the
back. Rows and columns are spread unevenly, so that most of the tile is face. The scalp has no pole:
there the rows close like a hood, as confocal ellipses around a slit in the sagittal plane.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import PchipInterpolator

ROWS = 124
COLUMNS = 112
CENTRE_MM = np.array([0.0, -15.0, -15.0])
"""Where the rays of the face start."""

FACE_RADIUS_MM = 104.0
"""How far from the centre the face lies; there all rays keep their azimuth and elevation."""

NOSE_SHIFT_MM = np.array([0.0, -18.0, 62.0])
"""How far ahead of the centre the rays of the nose start, to meet its sides less obliquely."""

SLIT_DEG = 25.0
"""Half the slit's length, as an angle from the vertical."""

ROW_HAIRLINE, ROW_BROW, ROW_LID_UP, ROW_LID_LOW = 12, 33, 43, 49
ROW_NOSE, ROW_LIP_UP, ROW_MOUTH, ROW_LIP_LOW, ROW_CHIN, ROW_THROAT = 72, 79, 84, 89, 104, 113

EYE_AZIMUTH_DEG, EYE_HALF_DEG = 19.4, 8.5
MOUTH_HALF_DEG = 14.8


@dataclasses.dataclass(frozen=True)
class Rays:
    """One ray for each grid point.

    Attributes:
        origins: (rows + 1, columns + 1, 3) mm.
        directions: the same shape, unit.
        azimuth_deg: (rows + 1, columns + 1), from +z toward +x.
        elevation_deg: the same shape.
    """

    origins: np.ndarray
    directions: np.ndarray
    azimuth_deg: np.ndarray
    elevation_deg: np.ndarray


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """(...) values: 0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def relaxed(grid: np.ndarray, share: np.ndarray, rounds: int = 18) -> np.ndarray:
    """Spread a grid's points evenly.

    Args:
        grid: (rows + 1, columns + 1, 3) mm.
        share: (rows + 1, columns + 1) 0..1, how freely each point moves; borders stay.
        rounds: how often.

    Returns:
        A grid of the same shape.
    """
    for _ in range(rounds):
        inner = 0.25 * (grid[:-2, 1:-1] + grid[2:, 1:-1] + grid[1:-1, :-2] + grid[1:-1, 2:])
        moved = grid.copy()
        moved[1:-1, 1:-1] += share[1:-1, 1:-1, None] * 0.6 * (inner - grid[1:-1, 1:-1])
        grid = moved
    return grid


def face_azimuth_deg() -> np.ndarray:
    """Azimuth of each column on the face: (columns + 1,) degrees, -180 to 180, dense in front."""
    half = COLUMNS // 2
    columns = np.array([23.0, 29.0, 35.0, 46.0, half])
    azimuth = np.array([28.0, 46.0, 76.0, 105.0, 180.0])
    curve = PchipInterpolator(
        np.concatenate([-columns[::-1], [0.0], columns]),
        np.concatenate([-azimuth[::-1], [0.0], azimuth]),
    )
    return np.asarray(curve(np.arange(-half, half + 1.0)))


def almond(position: np.ndarray, peak: float) -> np.ndarray:
    """Height of a lid over the line between the corners, 0..1.

    Args:
        position: (...) -1 at the inner corner, +1 at the outer one.
        peak: where the lid is highest.
    """
    p = np.clip(position, -1.0, 1.0)
    warped = np.where(p < peak, (p - peak) / (1 + peak), (p - peak) / (1 - peak))
    return (1 - np.abs(warped) ** 2.2) ** 0.9


def row_elevation_deg(azimuth_deg: np.ndarray) -> np.ndarray:
    """Elevation of every grid point, so that rows follow lids, lips and jaw.

    Args:
        azimuth_deg: (columns + 1,).

    Returns:
        (rows + 1, columns + 1) degrees, falling along each column.
    """
    a = np.abs(azimuth_deg)
    flat = np.zeros_like(a)
    behind = smoothstep(35.0, 140.0, a)
    eye = (a - EYE_AZIMUTH_DEG) / EYE_HALF_DEG
    inside = smoothstep(1.75, 1.0, np.abs(eye))
    canthus = 2.9 + 0.55 * np.clip(eye, -1, 1)
    up = canthus + 0.85 + 2.5 * almond(eye, -0.08)
    low = canthus - 0.85 - 1.9 * almond(eye, 0.2)
    mouth = a / MOUTH_HALF_DEG
    lips = smoothstep(2.6, 1.0, mouth)
    bow = 0.28 * np.exp(-((mouth / 0.09) ** 2)) - 0.22 * np.exp(-(((mouth - 0.22) / 0.12) ** 2))
    taper = np.sqrt(np.clip(1 - np.clip(mouth, 0, 1) ** 2, 0, 1))
    line = -25.2 - 4.4 * np.clip(mouth, 0, 1.0) ** 2 - 0.3 * np.exp(-((mouth / 0.2) ** 2))
    lip_up = line + 0.6 + 2.6 * taper**1.4 - bow
    lip_low = line - 0.6 - 5.0 * taper**1.45
    anchors = {
        0: flat + 90.0 - SLIT_DEG,
        ROW_HAIRLINE: flat + 43.0,
        ROW_BROW: flat + 15.5,
        ROW_LID_UP: inside * up + (1 - inside) * 5.9,
        ROW_LID_LOW: inside * low + (1 - inside) * 1.0,
        ROW_NOSE: flat - 18.6,
        ROW_LIP_UP: lips * lip_up + (1 - lips) * -24.4,
        ROW_MOUTH: lips * line + (1 - lips) * -29.6,
        ROW_LIP_LOW: lips * lip_low + (1 - lips) * -33.6,
        ROW_CHIN: -45.0 + 2.0 * behind,
        ROW_THROAT: -59.0 + 6.0 * behind,
        ROWS: -68.0 + 11.0 * behind,
    }
    rows = np.array(sorted(anchors), float)
    values = np.stack([anchors[int(r)] for r in rows])
    return np.asarray(PchipInterpolator(rows, values, axis=0)(np.arange(ROWS + 1.0)))


def head_rays() -> Rays:
    """The grid of rays; column 0 and the last column coincide, and the slit's two lips do."""
    half = COLUMNS // 2
    face = face_azimuth_deg()
    theta = 90.0 - row_elevation_deg(face)
    t = (np.arange(COLUMNS + 1) - half) / half
    slit = np.degrees(np.arccos(1 - 2 * np.abs(t) ** 1.3)) * np.sign(t)
    weight = smoothstep(SLIT_DEG, 60.0, theta)
    azimuth = np.radians((1 - weight) * slit + weight * face)
    closing = SLIT_DEG**2 * (1 - smoothstep(SLIT_DEG, 70.0, theta))
    ahead = theta * np.cos(azimuth)
    aside = np.sqrt(np.maximum(theta**2 - closing, 0.0)) * np.sin(azimuth)
    polar = np.radians(np.hypot(ahead, aside))
    phi = np.arctan2(aside, ahead)
    directions = np.stack(
        [np.sin(polar) * np.sin(phi), np.cos(polar), np.sin(polar) * np.cos(phi)], axis=-1
    )
    row = np.arange(ROWS + 1)[:, None]
    slide = smoothstep(ROW_CHIN - 14, ROWS + 14, row.astype(float)) * 1.3
    origins = CENTRE_MM + slide[..., None] * np.array([0.0, -55.0, -10.0])
    origins = np.broadcast_to(origins, directions.shape)
    azimuth_deg, elevation_deg = np.degrees(phi), 90.0 - np.degrees(polar)
    ahead_of = smoothstep(30.0, 6.0, np.abs(azimuth_deg))
    ahead_of = ahead_of * smoothstep(25.0, 2.0, elevation_deg)
    ahead_of = ahead_of * smoothstep(-42.0, -24.0, elevation_deg)
    through = origins + FACE_RADIUS_MM * directions
    origins = origins + ahead_of[..., None] * NOSE_SHIFT_MM
    directions = through - origins
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    origins, directions = _level_neck(origins, directions, phi)
    return Rays(origins, directions, azimuth_deg, elevation_deg)


def _level_neck(
    origins: np.ndarray, directions: np.ndarray, azimuth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Let the neck's rays start on its axis and leave it level; azimuth in radians."""
    row = np.arange(ROWS + 1.0)[:, None]
    ahead = np.cos(azimuth)
    height = -132.0 - 10.0 * ahead - 3.2 * (row - ROW_THROAT)
    level = smoothstep(ROW_CHIN - 1.0, ROW_THROAT + 3.0, row)[..., None]
    start = np.stack([0 * height, height, 0 * height - 25.0], axis=-1)
    out = np.stack([np.sin(azimuth), 0 * ahead, ahead], axis=-1)
    directions = (1 - level) * directions + level * out
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return (1 - level) * origins + level * start, directions
