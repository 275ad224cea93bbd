r"""The head as an implicit surface: ellipsoids and rounded cones in smooth union, with soft bumps.

Lengths in mm, head frame. Sizes follow the averages of adult anthropometry ([Farkas1994]).
The base is mirror-symmetric, so everything is written for x >= 0 and evaluated at \\|x\\|.
"""

from __future__ import annotations

import numpy as np

from sim.head.sections import section_distance

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
    """Smooth union (polynomial) of two (...) distances with a fillet of about `blend_mm`."""
    h = np.clip(0.5 + 0.5 * (b - a) / blend_mm, 0.0, 1.0)
    return b + (a - b) * h - blend_mm * h * (1.0 - h)


def carve(a: np.ndarray, b: np.ndarray, blend_mm: float) -> np.ndarray:
    """Smooth difference of two (...) distances: a without b."""
    return -join(-a, b, blend_mm)


def bump(
    p: np.ndarray, centre: tuple[float, float, float], sigma: tuple[float, float, float]
) -> np.ndarray:
    """Gaussian of height 1; p (n, 3)."""
    return np.exp(-0.5 * (((p - centre) / np.array(sigma)) ** 2).sum(axis=-1))


# What is added to the surface, mm: height, centre, spread.
BUMPS: tuple[tuple[float, tuple[float, float, float], tuple[float, float, float]], ...] = (
    (1.2, (22, 14, 94), (12, 5.5, 16)),  # brow ridge
    (1.2, (49, 10, 74), (9, 6, 14)),  # its outer end
    (1.6, (36, -40, 76), (12, 10, 16)),  # apple of the cheek
    (-1.6, (17, -24, 80), (6, 8, 14)),  # beside the nose, below the eye
    (-1.3, (27, -57, 88), (3.5, 9, 12)),  # fold from the nose to the mouth
    (-1.6, (30, -76, 78), (4.5, 6, 12)),  # beside the corners of the mouth
    (-0.8, (0, -109, 94), (3.5, 7, 10)),  # dimple between the halves of the chin
)


def base_distance(points: np.ndarray) -> np.ndarray:
    """Signed distance (about) to the head without lips and ears: (n, 3) mm to (n,) mm."""
    p = np.array(points, float)
    p[..., 0] = np.abs(p[..., 0])
    shape = p.shape[:-1]
    p = p.reshape(-1, 3)
    d = ellipsoid(p, (0, 24, -11), (71.5, 88, 88))
    d = join(d, ellipsoid(p, (0, 44, -26), (70, 63, 68)), 14)  # its sides above
    d = join(d, ellipsoid(p, (0, 8, -50), (59, 60, 48)), 20)  # back of the head
    d = join(d, ellipsoid(p, (0, 38, 18), (66, 70, 72)), 20)  # its front
    d = join(d, section_distance(p), 8)
    d = join(d, _neck(p), 16)
    for height, centre, sigma in BUMPS:
        d = d - height * bump(p, centre, sigma)
    return _eye(p, _nose(p, d)).reshape(shape)


def _neck(p: np.ndarray) -> np.ndarray:
    n = ellipsoid_column(p, (0, -40, -26), (0, -205, -24), (41, 48), (49, 56))
    n = join(n, cone(p, (50, -32, -24), (18, -200, 28), 10, 9), 12)  # turner of the head
    n = join(n, cone(p, (22, -50, -64), (34, -210, -60), 19, 28), 25)  # muscles of the nape
    n = join(n, cone(p, (0, -138, 20), (0, -152, 24), 8, 7), 18)  # larynx
    return join(n, cone(p, (0, -104, 62), (0, -124, 18), 14, 22), 18)  # floor of the mouth


def ellipsoid_column(
    p: np.ndarray,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    radii: tuple[float, float],
    end_radii: tuple[float, float],
) -> np.ndarray:
    """Distance (about) to an upright column of elliptic sections; radii along x and z; p (n, 3)."""
    a, b = np.array(start), np.array(end)
    t = np.clip((p[:, 1] - a[1]) / (b[1] - a[1]), 0.0, 1.0)
    middle = a + t[:, None] * (b - a)
    size = np.array(radii) + t[:, None] * (np.array(end_radii) - np.array(radii))
    q = (p - middle)[:, [0, 2]] / size
    flat = (np.linalg.norm(q, axis=1) - 1) * size.min(axis=1)
    return np.maximum(flat, p[:, 1] - a[1])


def _nose(p: np.ndarray, d: np.ndarray) -> np.ndarray:
    n = cone(p, (0, 6, 80), (0, -20, 92.5), 6.5, 7.5)  # bones
    n = join(n, cone(p, (0, -18, 92.5), (0, -40, 104.0), 7.0, 7.4), 5)  # bridge
    n = join(n, ellipsoid(p, (3.8, -42.0, 105.0), (7.6, 7.4, 8.0)), 4)  # tip, two domes
    n = join(n, cone(p, (0, -48, 101), (0, -53.5, 94), 3.4, 4.2), 4)  # columella
    n = join(n, cone(p, (0, -6, 78), (0, -42, 90), 8.0, 12.5), 8)  # what it stands on
    n = join(n, cone(p, (3, -24, 88), (6.5, -40, 96), 5.0, 6.0), 6)  # side walls
    d = join(d, n, 9)
    d = join(d, ellipsoid(p, (11.0, -45.6, 95), (6.6, 6.8, 9.5)), 5)  # wing
    d = d + 0.9 * bump(p, (15.5, -40.5, 95), (3.0, 3.0, 6.0))  # groove above the wing
    return carve(d, ellipsoid(p, (6.4, -53.0, 98.0), (3.2, 3.6, 5.6)), 3)  # nostril


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
