"""Places on the head as soft masks over our vertex grid: what the skin's painter paints by.

Places are given in mm of one fixed face. Another base head is carried onto that face by its
landmarks (`canonical`), so the masks stay where they belong when the base head changes.
"""

from __future__ import annotations

import functools

import numpy as np

from sim.head.grid import smoothstep
from sim.head.maps import over_grid, region_share
from sim.head.mesh import hairline_mm, landmarks, neutral_mesh

PLACE_ROWS, PLACE_COLUMNS = 768, 512

# Heights of landmarks on the fixed face, mm: jaw, mouth, nose base, nose tip, eyes, brows.
_KNOTS_Y = np.array([-117.9, -76.8, -56.1, -40.9, -9.0, 16.5])
_KNOTS_X = np.array([0.0, 16.0, 45.4, 69.4])
_BRIDGE_Z = 95.8

_Triple = tuple[float, float, float]


@functools.cache
def _marks() -> tuple[np.ndarray, np.ndarray, float]:
    """The base head's own values at the knots: y rising, x rising, z of the bridge."""
    p = neutral_mesh().vertices[landmarks()]
    y = np.array(
        [
            p[8, 1],
            p[[62, 66], 1].mean(),
            p[33, 1],
            p[30, 1],
            p[36:48, 1].mean(),
            p[17:27, 1].mean(),
        ]
    )
    x = np.abs(p[:, 0])
    out = np.array([0.0, x[[39, 42]].mean(), x[[36, 45]].mean(), x[[0, 16]].mean()])
    return y, out, float(p[27, 2])


def canonical(points: np.ndarray) -> np.ndarray:
    """Places of the base head on the fixed face: distance from the middle, y and z.

    Args:
        points: (..., 3) mm of the neutral base head.

    Returns:
        (..., 3) float32 mm; x is not negative.
    """
    y, x, bridge = _marks()
    out = np.empty(points.shape, np.float32)
    out[..., 0] = _bent(np.abs(points[..., 0]), x, _KNOTS_X)
    out[..., 1] = _bent(points[..., 1], y, _KNOTS_Y)
    out[..., 2] = points[..., 2] + (_BRIDGE_Z - bridge)
    return out


def _bent(values: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Piecewise-linear map through knots; beyond them a shift."""
    inside = np.interp(values, source, target)
    inside += np.minimum(values - source[0], 0) + np.maximum(values - source[-1], 0)
    return inside


@functools.cache
def place_masks() -> dict[str, np.ndarray]:
    """Soft masks 0..1 by name, each (PLACE_ROWS, PLACE_COLUMNS) float32 over the vertex grid.

    ``hairline`` is no mask but how far behind the hairline a place is, mm.
    """
    points = over_grid(neutral_mesh().vertices, PLACE_ROWS, PLACE_COLUMNS)
    p = canonical(points)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]

    def at(centre: _Triple, spread: _Triple) -> np.ndarray:
        away = (p - np.array(centre, np.float32)) / np.array(spread, np.float32)
        return np.asarray(np.exp(-0.5 * (away**2).sum(axis=-1)))

    def region(name: str) -> np.ndarray:
        return over_grid(region_share(name), PLACE_ROWS, PLACE_COLUMNS)

    lips = region("lips")
    tip = at((0, -42, 110), (11, 10, 14))
    wings = at((14, -47, 97), (6, 8, 12))
    nose = np.maximum(tip, 0.85 * wings)
    bridge = at((0, -16, 98), (8, 16, 14))
    forehead = at((0, 45, 85), (42, 17, 45))
    chin = at((0, -106, 84), (15, 11, 25))
    moustache = np.maximum(at((10, -64, 96), (15, 4.5, 25)), 0.9 * at((26, -72, 85), (5, 12, 20)))
    goatee = np.maximum(at((0, -106, 84), (20, 12, 40)), 0.8 * at((0, -92, 90), (9, 5, 25)))
    jaw = smoothstep(-46, -70, y - 0.30 * (62 - z)) * smoothstep(-150, -122, y)
    jaw = jaw * smoothstep(-8, 14, z)
    side = smoothstep(60, 66, x) * smoothstep(8, 22, z) * smoothstep(34, 26, z)
    side = side * smoothstep(2, -30, y) * smoothstep(-90, -50, y)
    # Between the moustache and the jaw the cheek grows less.
    cheek_gap = smoothstep(20, 30, x) * smoothstep(48, 36, x) * smoothstep(-96, -80, y)
    inside = smoothstep(24, 8, x) * smoothstep(-88, -84, y)
    growth = np.maximum(moustache, goatee)
    growth = np.maximum(growth, jaw * (1 - 0.5 * inside) * (1 - 0.5 * cheek_gap))
    beard = np.clip(np.maximum(growth, 0.8 * side), 0, 1) * (1 - lips)
    beard = beard * (1 - at((0, -50, 100), (16, 5, 20)))
    masks = {
        "skin": region("skin"),
        "lips": lips,
        "eyes": region("eyes"),
        "ears": region("ears"),
        "cheeks": at((42, -36, 70), (15, 13, 28)),
        "cheek_sides": at((56, -50, 45), (14, 22, 26)),
        "nose": nose,
        "wings": np.maximum(wings, 0.7 * at((13, -54, 93), (5, 4, 10))),
        "bridge": bridge,
        "chin": chin,
        "forehead": forehead,
        "temples": at((60, 18, 52), (10, 18, 20)),
        "jowls": at((36, -92, 60), (16, 12, 26)),
        "below_eyes": np.clip(
            at((28, -20.5, 82), (11, 4.0, 20)) + 0.7 * at((18, -13, 82), (5, 6, 20)), 0, 1
        ),
        "bags": at((30, -22, 82), (12, 3.5, 20)),
        "lids": at((31, -1.5, 84), (14, 4.5, 20)),
        "freckled": np.maximum(
            at((24, -26, 82), (20, 12, 30)),
            np.maximum(at((0, -25, 100), (12, 16, 20)), 0.45 * at((20, 40, 85), (30, 18, 40))),
        ),
        "beard": beard,
        "around_mouth": at((0, -76, 92), (24, 16, 30)) * (1 - lips),
        "oily": np.clip(nose + bridge + 0.9 * forehead + 0.55 * chin, 0, 1),
        "crow": at((57, -9, 62), (9, 10, 16)),
        "glabella": at((0, 17, 96), (9, 11, 16)),
        "neck": smoothstep(-118, -136, y + 0.35 * np.minimum(z - 60, 0)) * smoothstep(-60, -20, z),
        "hairline": hairline_mm(points),
    }
    return {name: np.asarray(value, np.float32) for name, value in masks.items()}
