"""The face as stacked horizontal sections: radius about a vertical axis by height and angle."""

from __future__ import annotations

import functools

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator, RectBivariateSpline

_ANGLES_DEG = np.linspace(0.0, 125.0, 126)
_FAR_DEG = 170.0

# Height y: places (x, z) of the section, mm, from the middle of the face to behind the ear; the
# nose and the lips' red are not in them, the eyelids are.
_SECTIONS: dict[float, tuple[tuple[float, float], ...]] = {
    90: ((0, 52), (22, 50), (38, 40), (50, 22), (55, 0), (50, -40)),
    75: ((0, 72), (24, 69), (42, 56), (56, 34), (63, 4), (65, -40)),
    60: ((0, 84), (26, 81), (44, 68), (57, 45), (66, 10), (70, -40)),
    42: ((0, 92.5), (26, 89), (44, 77), (56.5, 56), (64.5, 28), (69, 0), (72, -40)),
    28: ((0, 95.5), (24, 93), (41, 83), (53.5, 65), (61.5, 42), (67, 12), (72, -40)),
    18: ((0, 95.0), (20, 93.5), (36, 87.5), (48, 78), (57, 61), (63, 38), (68, 8), (71.5, -40)),
    11: ((0, 93.5), (16, 91), (30, 87), (44, 80), (54, 66), (61, 45), (67, 12), (71, -40)),
    3: ((0, 89), (14, 84.5), (26, 82.5), (40, 79), (51, 67), (59, 48), (66, 20), (70.5, -40)),
    -8: ((0, 82), (14, 76.5), (26, 75), (40, 70), (50, 63), (59, 47), (66, 20), (70, -40)),
    -18: ((0, 83), (14, 81), (27, 80), (40, 75), (51.5, 63.5), (60, 46), (65.5, 20), (68, -40)),
    -28: ((0, 85), (14, 84), (28, 82), (41, 76), (52.5, 64), (60.5, 46), (65, 20), (67, -40)),
    -40: ((0, 88), (14, 87.5), (28, 82.5), (41, 73.5), (53, 58), (60, 40), (64.5, 15), (66, -40)),
    -53: ((0, 94), (14, 91.5), (28, 83), (40, 70.5), (51, 53), (57.5, 34), (61.5, 10), (63, -40)),
    -65: ((0, 96.5), (14, 94), (27, 83.5), (38, 69), (48.5, 51), (55.5, 32), (60, 8), (61, -40)),
    -76: (
        (0, 95.5),
        (14, 92.5),
        (26, 81.5),
        (36, 67),
        (46, 49),
        (52.5, 30),
        (56.5, 7),
        (57.5, -40),
    ),
    -88: ((0, 90), (14, 87), (25, 77.5), (35, 63), (44, 46), (49.5, 28), (53, 6), (54, -40)),
    -100: ((0, 92), (12, 89.5), (23.5, 78), (34, 62), (42, 44), (47, 27), (48.5, 6), (49, -40)),
    -110: ((0, 91), (12, 87.5), (22.5, 75), (32, 60), (39.5, 43), (44.5, 26), (47, 6), (48, -40)),
    -124: ((0, 86), (12, 82), (21, 69), (30, 55), (37, 40), (43, 24), (46, 6), (47, -40)),
}

# The lower border of the jaw: angle in degrees against height in mm.
_BORDER_DEG = (0, 10, 20, 30, 42, 55, 68, 80, 90, 100, 125, 170)
_BORDER_MM = (-119.0, -118.5, -116, -111.5, -105, -97.5, -89.5, -80, -66, -48, -30, -28)


@functools.cache
def _radius() -> RectBivariateSpline:
    heights = np.array(sorted(_SECTIONS))
    rows = []
    for y in heights:
        x, z = np.array(_SECTIONS[y]).T
        angle = np.degrees(np.arctan2(x, z))
        # Even across the middle, so that the face has no ridge there.
        angle = np.concatenate([-angle[:0:-1], angle])
        radius = np.hypot(x, z)
        radius = np.concatenate([radius[:0:-1], radius])
        rows.append(CubicSpline(angle, radius, bc_type="natural")(_ANGLES_DEG))
    return RectBivariateSpline(heights, _ANGLES_DEG, np.array(rows), kx=3, ky=3)


@functools.cache
def _border() -> PchipInterpolator:
    return PchipInterpolator(_BORDER_DEG, _BORDER_MM)


def section_distance(points: np.ndarray) -> np.ndarray:
    """Signed distance (about) to the stacked sections, above the jaw's border.

    Args:
        points: (n, 3) mm, x >= 0.

    Returns:
        (n,) mm, negative inside.
    """
    x, y, z = points.T
    angle = np.degrees(np.arctan2(x, z))
    height, turn = np.clip(y, -124.0, 90.0), np.clip(angle, 0.0, 125.0)
    radius = _radius().ev(height, turn)
    steep_up = _radius().ev(height, turn, dx=1)
    steep_round = np.degrees(_radius().ev(height, turn, dy=1)) / np.maximum(radius, 1.0)
    side = (np.hypot(x, z) - radius) / np.sqrt(1 + steep_up**2 + steep_round**2)
    below = (_border()(np.clip(angle, 0.0, _FAR_DEG)) - y) * 0.9
    above = y - 84.0
    # Smooth maxima keep the jaw's border and the top round.
    edge = np.maximum(16.0 - np.abs(side - below), 0) / 16.0
    d = np.maximum(side, below) + edge**2 * 4.0
    edge = np.maximum(20.0 - np.abs(d - above), 0) / 20.0
    return np.maximum(d, above) + edge**2 * 5.0
