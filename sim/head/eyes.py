"""Eyes: balls that stay round under lids that move, lids that clear them, lids that close."""

from __future__ import annotations

import functools

import numpy as np

from sim.head.grid import (
    EYE_AZIMUTH_DEG,
    EYE_HALF_DEG,
    ROW_LID_LOW,
    ROW_LID_UP,
    face_azimuth_deg,
    smoothstep,
)
from sim.head.shape import EYE_CENTRE_MM, EYE_RADIUS_MM

LID_MM = 1.3
"""How far a lid's outside stands off the eyeball."""
CORNEA_MM = 0.9
"""How far the cornea bulges out of the ball."""

_CREASE = ROW_LID_UP - 7
_LEAST_OPEN = 0.035
"""What closed lids leave of the opening: their rims stay two sheets."""


def _place() -> np.ndarray:
    """(columns + 1,) -1 at the inner corner to 1 at the outer one."""
    return (np.abs(face_azimuth_deg()) - EYE_AZIMUTH_DEG) / EYE_HALF_DEG


@functools.cache
def _sides() -> tuple[tuple[float, np.ndarray, np.ndarray], ...]:
    """For each eye: sign of x, its columns, and how much of each is between the lids, 0..1."""
    weight = smoothstep(1.02, 0.8, np.abs(_place()))
    sign = np.sign(face_azimuth_deg())
    columns = [np.flatnonzero((sign == side) & (weight > 0)) for side in (-1.0, 1.0)]
    return tuple((s, c, weight[c]) for s, c in zip((-1.0, 1.0), columns, strict=True))


def _on_ball(place: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Where the eye's surface is behind (..., 3) places of the opening between the lids."""
    offset = place - centre
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    pupil = centre + np.array([0, 0.5, EYE_RADIUS_MM])
    away = np.linalg.norm(place - pupil, axis=-1, keepdims=True)
    ball = EYE_RADIUS_MM + CORNEA_MM * np.exp(-((away / 5.8) ** 4))
    # Beyond the ball the corners are filled: caruncle and membrane lie close behind the lids.
    reach = np.logaddexp(4.0 * ball, 4.0 * (distance - 0.9)) / 4.0
    return np.asarray(centre + offset / distance * reach)


def open_lids(grid: np.ndarray) -> np.ndarray:
    """Put eyeballs between the lids of a cast grid (rows + 1, columns + 1, 3) mm; a new grid."""
    result = grid.copy()
    rows = np.arange(len(grid))
    for side, columns, weight in _sides():
        centre = EYE_CENTRE_MM * (side, 1, 1)
        inner = slice(ROW_LID_UP + 1, ROW_LID_LOW)
        lids = grid[ROW_LID_UP : ROW_LID_LOW + 1, columns]
        # The rows next to the margins go to its foot, so that the lid's edge is steep.
        part = np.array([0.08, 0.3, 0.5, 0.7, 0.92])[:, None, None]
        place = lids[:1] * (1 - part) + lids[-1:] * part
        w = weight[None, :, None]
        ball = _on_ball(place, centre)
        result[inner, columns] = w * ball + (1 - w) * grid[inner, columns]
        crease = np.exp(-0.5 * ((rows - ROW_LID_UP + 4.0) / 1.0) ** 2)[:, None] * weight
        result[:, columns, 2] -= 1.3 * crease
    return result


def around_eyes(moved: np.ndarray, *, rigid: bool) -> np.ndarray:
    """Make a displacement leave the eyeballs round; linear in it.

    Args:
        moved: (rows + 1, columns + 1, 3) mm displacement of the grid.
        rigid: whether the balls go where the lids go on the whole (people differ) or stay where
            they are (faces move).

    Returns:
        The same, with the rows on the ball moved as one and those at its rim with their lid.
    """
    out = moved.copy()
    for _, columns, weight in _sides():
        upper, lower = moved[ROW_LID_UP, columns], moved[ROW_LID_LOW, columns]
        ball = 0.5 * (upper + lower) * weight[:, None]
        ball = ball.sum(axis=0) / weight.sum() if rigid else np.zeros(3)
        # Toward the corners the lids are too close to leave room for a ball of its own.
        free = smoothstep(1.0, 0.55, np.abs(_place()[columns]))[:, None]
        for row in range(ROW_LID_UP + 1, ROW_LID_LOW):
            part = (row - ROW_LID_UP) / (ROW_LID_LOW - ROW_LID_UP)
            near = {ROW_LID_UP + 1: upper, ROW_LID_LOW - 1: lower}.get(row)
            target = ball if near is None else near
            between = (1 - part) * upper + part * lower
            target = free * target + (1 - free) * between
            w = weight[:, None]
            out[row, columns] = w * target + (1 - w) * between
    return out


def eye_centres(grid: np.ndarray, neutral: np.ndarray) -> np.ndarray:
    """(2, 3) mm middles of the eyeballs, right first, by how far their rows have moved."""
    middle = (ROW_LID_UP + ROW_LID_LOW) // 2
    out = []
    for side, columns, weight in _sides():
        inside = columns[weight > 0.999]
        shift = (grid[middle, inside] - neutral[middle, inside]).mean(axis=0)
        out.append(EYE_CENTRE_MM * (side, 1, 1) + shift)
    return np.array(out)


def clear_of_eyes(grid: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Push lids out of the eyeballs, where a sum of displacements brought them too near.

    Args:
        grid: (rows + 1, columns + 1, 3) mm.
        centres: (2, 3) mm of the eyeballs.
    """
    result = grid.copy()
    lids = [*range(ROW_LID_UP - 6, ROW_LID_UP + 1), *range(ROW_LID_LOW, ROW_LID_LOW + 6)]
    for (_, columns, weight), centre in zip(_sides(), centres, strict=True):
        place = np.ix_(lids, columns)
        offset = grid[place] - centre
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        least = EYE_RADIUS_MM + LID_MM
        # Smooth maximum, so that the lid has no edge where it starts to rest on the ball.
        out = np.logaddexp(3.0 * distance, 3.0 * least) / 3.0
        w = weight[None, :, None]
        result[place] += w * (out - distance) * offset / distance
    return result


def seat_balls(grid: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Keep the ball's rows between its lids, in their order, and on the ball.

    Args:
        grid: (rows + 1, columns + 1, 3) mm, open lids, however narrow.
        centres: (2, 3) mm of the eyeballs.
    """
    result = grid.copy()
    least = np.array([0.08, 0.2, 0.34, 0.5, 0.92])[:, None]
    most = np.array([0.08, 0.5, 0.66, 0.8, 0.92])[:, None]
    inner = slice(ROW_LID_UP + 1, ROW_LID_LOW)
    for (_, columns, weight), centre in zip(_sides(), centres, strict=True):
        upper, lower = grid[ROW_LID_UP, columns], grid[ROW_LID_LOW, columns]
        chord = lower - upper
        size = np.maximum((chord**2).sum(axis=1), 1e-9)
        here = grid[inner, columns]
        part = np.einsum("rcx,cx->rc", here - upper, chord) / size
        # In the corners, where there is no room, the rows are spread evenly.
        free = smoothstep(0.9, 0.4, np.abs(_place()[columns]))
        even = (1 - free) * np.arange(1, 6)[:, None] / 6
        wanted = np.clip(part, free * least + even, free * most + even)
        ball = _on_ball(upper + wanted[..., None] * chord, centre)
        w = weight[None, :, None]
        result[inner, columns] = w * ball + (1 - w) * here
    return result


def close_lids(grid: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The upper lids slide over the eyeballs until they meet the lower ones.

    Args:
        grid: (rows + 1, columns + 1, 3) mm, open lids.
        centres: (2, 3) mm of the eyeballs.

    Returns:
        (rows + 1, columns + 1, 3) mm displacement. What was ball between the lids goes into a cleft
        behind their rims.
    """
    moved = grid.copy()
    reach = smoothstep(1.2, 0.9, np.abs(_place()))
    inside = smoothstep(1.0, 0.8, np.abs(_place()))
    for (side, _, _), centre in zip(_sides(), centres, strict=True):
        columns = np.flatnonzero((np.sign(face_azimuth_deg()) == side) & (reach > 0))
        g = grid[:, columns]
        upper, lower = g[ROW_LID_UP], g[ROW_LID_LOW] + 0.08 * (g[ROW_LID_UP] - g[ROW_LID_LOW])
        margin = lower + _LEAST_OPEN * (upper - lower)
        w = reach[columns][:, None]

        def on_ball(place: np.ndarray, depth_mm: float, centre: np.ndarray = centre) -> np.ndarray:
            offset = place - centre
            distance = np.linalg.norm(offset, axis=1, keepdims=True)
            return centre + offset / distance * np.maximum(distance, EYE_RADIUS_MM + depth_mm)

        # A closed lid is as round as the ball, and as far from it as the rim where they meet.
        far = np.linalg.norm(margin - centre, axis=1, keepdims=True)
        far = np.maximum(far, EYE_RADIUS_MM + LID_MM + 0.2)
        top, bottom = on_ball(margin, LID_MM + 0.2), on_ball(lower, LID_MM)
        new = g.copy()
        for row in range(_CREASE + 1, ROW_LID_UP + 1):
            part = (row - _CREASE) / (ROW_LID_UP - _CREASE)
            chord = g[_CREASE] * (1 - part) + margin * part
            offset = chord - centre
            round_lid = centre + offset / np.linalg.norm(offset, axis=1, keepdims=True) * far
            share = smoothstep(0.15, 0.7, np.array(part)) * smoothstep(
                1.0, 0.5, np.abs(_place()[columns])
            )
            new[row] = chord + share[:, None] * (round_lid - chord)
            new[row] = on_ball(new[row], LID_MM + 0.2)
        new[ROW_LID_LOW] = bottom
        for row in range(ROW_LID_UP + 1, ROW_LID_LOW):
            part = (row - ROW_LID_UP) / (ROW_LID_LOW - ROW_LID_UP)
            rim = top + part * (bottom - top)
            inward = (centre - rim) / np.linalg.norm(centre - rim, axis=1, keepdims=True)
            new[row] = rim + 2.4 * min(part, 1 - part) * inward * inside[columns][:, None]
        moved[:, columns] = g + w * (new - g)
    return moved - grid
