r"""The head as an implicit surface: ellipsoids and rounded cones in smooth union, with soft bumps.

Lengths in mm, head frame. Sizes follow the averages of adult anthropometry ([Farkas1994]).
The base is mirror-symmetric, so everything is written for x >= 0 and evaluated at \\|x\\|.
"""

from __future__ import annotations

import numpy as np

EYE_CENTRE_MM = np.array([31.5, -8.0, 68.5])
EYE_RADIUS_MM = 12.2


def ellipsoid(
    p: np.ndarray, centre: tuple[float, float, float], radii: tuple[float, float, float]
) -> np.ndarray:
    """First-order distance to an ellipsoid, negative inside; p (n, 3)."""
    q = (p - centre) / np.array(radii)
    length = np.linalg.norm(q, axis=-1)
    slope = np.linalg.norm(q / np.array(radii), axis=-1)
    return length * (length - 1.0) / np.maximum(slope, 1e-9)


def cone(
    p: np.ndarray,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    radius: float,
    end_radius: float,
) -> np.ndarray:
    """Distance to a capsule whose radius changes along it; p (n, 3)."""
    a, b = np.array(start), np.array(end)
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return (
        np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - radius - t * (end_radius - radius)
    )


def join(a: np.ndarray, b: np.ndarray, blend_mm: float) -> np.ndarray:
    """Smooth union (polynomial) with a fillet of about `blend_mm`."""
    h = np.clip(0.5 + 0.5 * (b - a) / blend_mm, 0.0, 1.0)
    return b + (a - b) * h - blend_mm * h * (1.0 - h)


def carve(a: np.ndarray, b: np.ndarray, blend_mm: float) -> np.ndarray:
    """Smooth difference: a without b."""
    return -join(-a, b, blend_mm)


def bump(
    p: np.ndarray, centre: tuple[float, float, float], sigma: tuple[float, float, float]
) -> np.ndarray:
    """Gaussian of height 1; p (n, 3)."""
    return np.exp(-0.5 * (((p - centre) / np.array(sigma)) ** 2).sum(axis=-1))


# What is added to the surface, mm: height, centre, spread.
BUMPS: tuple[tuple[float, tuple[float, float, float], tuple[float, float, float]], ...] = (
    (2.2, (24, 15, 92), (14, 6.5, 20)),  # brow ridge
    (2.5, (44, 13, 78), (10, 6, 20)),  # its outer end
    (-1.0, (0, 13, 98), (6, 8, 20)),  # between the brows
    (-4.0, (21, -3, 84), (8, 7, 18)),  # inner eye socket
    (-4.0, (38, -20, 78), (14, 8, 18)),  # below the eye
    (4.0, (54, -26, 55), (13, 10, 20)),  # cheekbone
    (3.5, (36, -38, 74), (13, 11, 18)),  # apple of the cheek
    (-2.0, (50, -66, 50), (12, 14, 25)),  # hollow cheek
    (-2.5, (60, 20, 50), (10, 20, 18)),  # temple
    (2.0, (33, -64, 76), (6, 12, 18)),  # beside the mouth
    (-1.4, (22, -55, 92), (4, 8, 16)),  # fold from the nose to the mouth
)


def base_distance(points: np.ndarray) -> np.ndarray:
    """Signed distance (about) to the head without lips and ears: (n, 3) mm to (n,) mm."""
    p = np.array(points, float)
    p[..., 0] = np.abs(p[..., 0])
    d = ellipsoid(p, (0, 22, -8), (75, 90, 92))
    d = join(d, ellipsoid(p, (0, 30, 22), (62, 66, 72)), 18)  # forehead
    d = join(d, ellipsoid(p, (0, -34, 22), (65, 66, 64)), 16)  # middle of the face
    d = join(d, ellipsoid(p, (0, -70, 50), (36, 42, 43)), 16)  # jaws and teeth
    d = join(d, cone(p, (45, -58, 4), (14, -101, 67), 13, 13), 24)  # jaw line
    d = join(d, ellipsoid(p, (0, -103, 77), (16, 13, 17)), 14)  # chin
    d = join(d, cone(p, (0, -50, -24), (0, -190, -40), 50, 57), 30)  # neck
    for height, centre, sigma in BUMPS:
        d = d - height * bump(p, centre, sigma)
    d = _nose(p, d)
    return _eye(p, d)


def _nose(p: np.ndarray, d: np.ndarray) -> np.ndarray:
    n = cone(p, (0, 2, 86.5), (0, -26, 95.5), 7.0, 8.5)
    n = join(n, cone(p, (0, -24, 96), (0, -41, 104), 8.2, 9.2), 6)
    n = join(n, ellipsoid(p, (0, -42.5, 104.8), (10, 8.6, 10)), 5)  # tip
    n = join(n, ellipsoid(p, (11.2, -46, 96), (6.8, 7.2, 10)), 4)  # wing
    n = join(n, cone(p, (0, -49, 103), (0, -54, 97), 4, 5), 4)  # columella
    n = join(n, cone(p, (0, -12, 84), (0, -45, 92), 8.5, 11.5), 8)  # what it stands on
    d = join(d, n, 10)
    return carve(d, ellipsoid(p, (6.6, -54.5, 99.5), (3.2, 3.5, 5.0)), 4)  # nostril


def _eye(p: np.ndarray, d: np.ndarray) -> np.ndarray:
    lid = np.linalg.norm(p - EYE_CENTRE_MM, axis=-1) - EYE_RADIUS_MM - 1.4
    return join(d, lid, 5)


def cast(origins: np.ndarray, directions: np.ndarray, far_mm: float = 175.0) -> np.ndarray:
    """Where rays from inside leave the surface.

    Args:
        origins: (..., 3) inside, mm.
        directions: (..., 3) unit.
        far_mm: outside for every ray.

    Returns:
        (..., 3) points, to about 1e-6 mm.
    """
    low = np.full(directions.shape[:-1], 5.0)
    high = np.full(directions.shape[:-1], far_mm)
    for _ in range(28):
        middle = 0.5 * (low + high)
        inside = base_distance(origins + middle[..., None] * directions) < 0
        low = np.where(inside, middle, low)
        high = np.where(inside, high, middle)
    return origins + (0.5 * (low + high))[..., None] * directions
