"""Eyes between the lids: sclera with its veins, iris with limbus and fibres, pupil."""

from __future__ import annotations

import numpy as np

from sim.head.grid import ROW_LID_LOW, ROW_LID_UP, smoothstep
from sim.head.shape import EYE_CENTRE_MM
from sim.skin.hair import eye_place
from sim.skin.noise import octaves
from sim.skin.parts import Patch

IRIS_MM, PUPIL_MM = 5.9, 1.75
_SCLERA = np.array([0.46, 0.41, 0.375], np.float32)
_PINK = np.array([0.36, 0.165, 0.14], np.float32)


def paint_eyes(
    albedo: np.ndarray, patch: Patch, iris: tuple[float, float, float], age: float
) -> None:
    """Paint both eyes into (h, columns, 3) linear albedo, in place.

    What lids and lashes shade is part of the paint, as in any texture of a photographed eye.

    Args:
        albedo: (h, columns, 3) of the strip.
        patch: where.
        iris: linear albedo of its middle zone.
        age: 0 to 1: the white yellows.
    """
    share = patch.mask("eyes")
    here = share > 0
    if not here.any():
        return
    across, row = (part[here] for part in eye_place(patch))
    p = patch.reference[here].astype(np.float32)
    side = np.sign(p[:, 0])
    dx, dy = np.abs(p[:, 0]) - np.float32(EYE_CENTRE_MM[0]), p[:, 1] - np.float32(EYE_CENTRE_MM[1])
    radius, turn = np.hypot(dx, dy), np.arctan2(dy, dx)
    seed = patch.face.seed
    white = _white(p, across, radius, seed, age)
    colour = _iris(radius, turn, side, np.array(iris, np.float32), seed)
    edge = smoothstep(IRIS_MM + 0.35, IRIS_MM - 0.35, radius)[:, None]
    out = white + edge * (colour - white)
    # The upper lid and its lashes shade the ball below them.
    open_rows = float(ROW_LID_LOW - ROW_LID_UP)
    down = (row - ROW_LID_UP) / open_rows
    shade = 1 - 0.55 * smoothstep(0.48, 0.02, down) - 0.22 * smoothstep(0.86, 1.0, down)
    shade *= 1 - 0.30 * smoothstep(0.72, 1.0, np.abs(across))
    out = out * shade[:, None]
    # Inner corner, and the wet rim of the lower lid.
    pink = np.maximum(smoothstep(-0.80, -0.95, across), 0.75 * smoothstep(0.9, 1.0, down))
    out += pink[:, None] * (_PINK * (0.75 + 0.25 * shade[:, None]) - out)
    albedo[here] += share[here][:, None] * (out - albedo[here])


def _white(
    p: np.ndarray, across: np.ndarray, radius: np.ndarray, seed: int, age: float
) -> np.ndarray:
    """(n, 3) the sclera with its veins."""
    bent = p + 0.5 * np.stack([octaves(p, 2.5, 2, seed + k) for k in (71, 72, 73)], axis=-1)
    stretched = bent * np.array([0.35, 1.0, 1.0], np.float32)
    ridge = 1 - np.abs(octaves(stretched, 2.2, 1, seed + 74))
    veins = smoothstep(0.80, 1.0, ridge) * smoothstep(6.0, 10.0, radius)
    veins *= 0.35 + 0.65 * smoothstep(0.35, 0.9, np.abs(across))
    flush = smoothstep(0.45, 1.0, np.abs(across))
    white = np.broadcast_to(_SCLERA * np.array([1, 1 - 0.03 * age, 1 - 0.16 * age]), p.shape).copy()
    white *= 1 + 0.04 * octaves(p, 3.0, 2, seed + 75)[:, None]
    white -= (0.30 * veins)[:, None] * np.array([0.12, 0.42, 0.40], np.float32)
    return np.asarray(white * (1 - flush[:, None] * np.array([0.06, 0.20, 0.22], np.float32)))


def _iris(
    radius: np.ndarray, turn: np.ndarray, side: np.ndarray, colour: np.ndarray, seed: int
) -> np.ndarray:
    """(n, 3) the iris: radial fibres, a brighter ring about the pupil, the dark limbus."""
    polar = np.stack(
        [4.6 * np.cos(turn), 4.6 * np.sin(turn) + 30 * side, 0.35 * radius], axis=-1
    ).astype(np.float32)
    fibres = octaves(polar, 1.1, 3, seed + 76)
    clouds = octaves(polar, 3.5, 2, seed + 77)
    part = radius / IRIS_MM
    bright = 1 + 0.26 * fibres + 0.12 * clouds
    collar = np.exp(-(((part - 0.48 - 0.03 * clouds) / 0.11) ** 2))
    bright = bright * (1 + 0.45 * collar) * (1 - 0.72 * smoothstep(0.78, 1.0, part))
    bright = bright * (1 - 0.35 * smoothstep(0.42, 0.30, part))
    # Around the pupil the iris is browner, whatever its colour.
    brown = np.array([0.105, 0.055, 0.026], np.float32)
    mix = (0.55 * smoothstep(0.62, 0.36, part + 0.05 * clouds))[:, None]
    out = np.clip(bright, 0.08, 2.2)[:, None] * (colour * (1 - mix) + brown * mix)
    pupil = smoothstep(PUPIL_MM - 0.18, PUPIL_MM + 0.18, radius)[:, None]
    return np.asarray(0.004 + pupil * out)
