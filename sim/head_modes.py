"""How heads differ and move: anatomical fields, their principal modes, expressions.

Every field is a smooth displacement of the neutral head's vertices in mm. Heads are linear in the
fields, so the principal components of independent unit draws follow exactly from the fields' Gram
matrix, with no sampling.
"""

from __future__ import annotations

import functools

import numpy as np

from sim.head_grid import (
    COLUMNS,
    EYE_AZIMUTH_DEG,
    EYE_HALF_DEG,
    MOUTH_HALF_DEG,
    ROW_CHIN,
    ROW_LID_LOW,
    ROW_LID_UP,
    ROW_MOUTH,
    ROWS,
    face_azimuth_deg,
    smoothstep,
)
from sim.head_mesh import grid_vertices, neutral_mesh
from sim.head_shape import EYE_CENTRE_MM, EYE_RADIUS_MM

IDENTITY_MODES = 10
EXPRESSIONS = ("smile", "jaw_open", "brow_raise", "brow_furrow", "pucker", "eyes_closed")

_Triple = tuple[float, float, float]

# Displacement of one standard deviation, mm (x away from the middle), its centre and spread.
_LOCAL: dict[str, tuple[tuple[_Triple, _Triple, _Triple], ...]] = {
    "jaw_width": (((4.0, 0, 0), (54, -76, 20), (26, 28, 36)),),
    "chin_forward": (((0, 0, 3.0), (0, -108, 78), (26, 18, 30)),),
    "cheekbones": (((3.0, 0, 0.8), (62, -22, 45), (22, 18, 30)),),
    "cheeks_full": (((2.8, 0, 2.0), (46, -56, 58), (20, 24, 28)),),
    "brow_ridge": (((0, -0.7, 1.6), (25, 15, 90), (24, 9, 20)),),
    "forehead": (((0, 0, 3.2), (0, 55, 78), (52, 26, 40)),),
    "nose_length": (((0, -2.6, 0.6), (0, -44, 102), (20, 18, 24)),),
    "nose_width": (((1.7, 0, 0), (14, -46, 96), (9, 10, 16)),),
    "bridge_height": (((0, 0, 2.0), (0, -12, 94), (11, 17, 20)),),
    "tip_forward": (((0, 0, 2.4), (0, -42, 108), (15, 12, 18)),),
    "tip_up": (((0, 1.8, 0), (0, -43, 108), (13, 10, 16)),),
    "bridge_width": (((0.9, 0, 0), (9, -10, 92), (8, 17, 16)),),
    "lips_full": (
        ((0, 0.9, 0.8), (0, -67, 96), (20, 5, 18)),
        ((0, -0.9, 0.9), (0, -81, 95), (19, 5, 18)),
    ),
    "mouth_width": (((2.0, 0, -0.4), (24, -74, 86), (15, 13, 22)),),
    "mouth_forward": (((0, 0, 2.2), (0, -74, 92), (30, 20, 30)),),
    "eye_spacing": (((1.3, 0, 0), (31, -8, 76), (17, 15, 22)),),
    "eye_depth": (((0, 0, -1.6), (31, -6, 76), (18, 15, 22)),),
    "brow_height": (((0, 1.7, 0), (32, 17, 84), (26, 9, 22)),),
    "ears_out": (((2.2, 0, 0), (80, -14, -18), (16, 26, 18)),),
    "below_chin": (((0, -2.6, 0.8), (0, -122, 45), (36, 16, 28)),),
    "ears_long": (
        ((0, -2.0, 0), (76, -38, -8), (14, 16, 16)),
        ((0, 2, 0), (78, 10, -16), (14, 14, 16)),
    ),
}

# One-sided fields, mm: the same displacement on both sides of the face.
_SIDED: dict[str, tuple[_Triple, _Triple, _Triple]] = {
    "nose_aside": ((0.9, 0, 0), (0, -34, 102), (16, 18, 20)),
    "chin_aside": ((1.3, 0, 0), (0, -104, 70), (34, 26, 40)),
    "right_brow_up": ((0, 0.8, 0), (-34, 15, 82), (16, 10, 20)),
    "left_corner_up": ((0, 0.7, 0), (26, -74, 84), (14, 12, 20)),
    "right_jaw_out": ((-1.4, 0, 0), (-54, -76, 20), (26, 28, 36)),
    "left_eye_down": ((0, -0.6, 0), (31, -8, 76), (16, 14, 20)),
}


def _window(points: np.ndarray, centre: _Triple, spread: _Triple) -> np.ndarray:
    return np.exp(-0.5 * (((points - centre) / np.array(spread)) ** 2).sum(axis=-1))


def _paired(points: np.ndarray, term: tuple[_Triple, _Triple, _Triple]) -> np.ndarray:
    """A mirrored displacement, smooth across the middle."""
    move, centre, spread = term
    folded = points.copy()
    folded[:, 0] = np.abs(folded[:, 0])
    out = _window(folded, centre, spread)[:, None] * np.array(move)
    out[:, 0] *= points[:, 0] / np.sqrt(points[:, 0] ** 2 + 36.0)
    return out


def _broad_fields(p: np.ndarray) -> dict[str, np.ndarray]:
    """Fields that reach over the whole head."""
    x, y, z = p.T
    zero = np.zeros_like(x)
    below = np.clip(y, -119, 0)
    eye = _window(np.abs(p) * (1, 0, 1) + p * (0, 1, 0), (31.5, -8, 76), (15, 11, 20))
    neck = smoothstep(-95, -135, y)
    return {
        "head_width": np.stack([0.035 * x, zero, zero], axis=1),
        "head_length": np.stack([zero, zero, 0.03 * z], axis=1),
        "cranium_height": np.stack([zero, 4.5 * smoothstep(25, 115, y), zero], axis=1),
        "face_height": np.stack([zero, 0.042 * below, zero], axis=1),
        "chin_height": np.stack([zero, -3.0 * smoothstep(-84, -118, y), zero], axis=1),
        "eye_opening": np.stack([zero, 0.11 * eye * (y + 8), zero], axis=1),
        "eye_tilt": np.stack([zero, 0.075 * eye * (np.abs(x) - 31), zero], axis=1),
        "neck_width": np.stack([0.06 * neck * x, zero, 0.06 * neck * (z + 30)], axis=1),
    }


@functools.cache
def identity_fields() -> tuple[tuple[str, ...], np.ndarray]:
    """Names and (k, n, 3) displacements in mm, each of one standard deviation, independent."""
    points = neutral_mesh().vertices
    fields = _broad_fields(points)
    for name, terms in _LOCAL.items():
        fields[name] = np.sum([_paired(points, term) for term in terms], axis=0)
    for name, (move, centre, spread) in _SIDED.items():
        fields[name] = _window(points, centre, spread)[:, None] * np.array(move)
    stacked = np.stack(list(fields.values()))
    stacked.flags.writeable = False
    return tuple(fields), stacked


@functools.cache
def identity_modes() -> np.ndarray:
    """(IDENTITY_MODES, n, 3) principal modes of the fields, mm at one standard deviation."""
    _, fields = identity_fields()
    flat = fields.reshape(len(fields), -1)
    _, vectors = np.linalg.eigh(flat @ flat.T)
    # With unit draws a, a . F = sum_i (a . w_i) (w_i . F): w_i . F is one deviation of mode i.
    modes = vectors[:, ::-1][:, :IDENTITY_MODES].T @ flat
    largest = np.abs(modes).argmax(axis=1)
    modes *= np.sign(modes[np.arange(len(modes)), largest])[:, None]
    modes = modes.reshape(IDENTITY_MODES, -1, 3)
    modes.flags.writeable = False
    return modes


@functools.cache
def expression_modes() -> np.ndarray:
    """(len(EXPRESSIONS), n, 3) displacements in mm at full strength."""
    points = neutral_mesh().vertices

    def paired(*terms: tuple[_Triple, _Triple, _Triple]) -> np.ndarray:
        return np.asarray(np.sum([_paired(points, term) for term in terms], axis=0))

    smile = paired(
        ((6.0, 4.5, -4.5), (25, -74, 84), (11, 10, 20)),
        ((1.0, 3.0, 2.6), (39, -42, 72), (14, 12, 22)),
        ((0, 1.2, 0), (32, -17, 78), (13, 5, 18)),
        ((0, -0.8, -1.0), (0, -66, 98), (14, 8, 16)),
        ((1.2, 1.0, 0), (14, -47, 96), (8, 8, 14)),
    )
    raised = paired(
        ((0, 5.5, 0), (32, 17, 84), (28, 10, 26)),
        ((0, 2.5, -0.5), (0, 38, 92), (45, 16, 30)),
        ((0, 0.9, 0.2), (31, -2, 80), (13, 3.5, 18)),
    )
    furrow = paired(
        ((-3.6, -3.2, 0.6), (15, 14, 92), (12, 9, 18)),
        ((0, -2.2, 0), (36, 15, 84), (16, 8, 18)),
        ((0, -0.9, 0), (28, -2, 80), (13, 4, 18)),
    )
    pucker = paired(
        ((-8.5, 0, 4.0), (25, -74, 84), (13, 12, 22)),
        ((0, 0, 6.0), (0, -74, 95), (17, 12, 24)),
        ((0, 1.4, 0), (0, -67, 97), (14, 5, 18)),
        ((0, -1.4, 0), (0, -81, 96), (14, 5, 18)),
    )
    modes = np.stack([smile, _jaw_open(), raised, furrow, pucker, _eyes_closed()])
    modes.flags.writeable = False
    return modes


def _to_vertices(values: np.ndarray, count: int) -> np.ndarray:
    out = np.zeros((count, *values.shape[2:]))
    out[grid_vertices().ravel()] = values.reshape(-1, *values.shape[2:])
    return out


def _jaw_open(angle_deg: float = 11.0) -> np.ndarray:
    """The jaw turns about the axis through its joints; the lips part at the mouth's row."""
    points = neutral_mesh().vertices
    azimuth = np.abs(face_azimuth_deg())
    row = np.arange(ROWS + 1.0)[:, None]
    width = 0.5 + 26.0 * smoothstep(0.8 * MOUTH_HALF_DEG, 60.0, azimuth) + 0 * row
    weight = smoothstep(-1.0, 1.0, (row - ROW_MOUTH) / width)
    weight = weight * smoothstep(95.0, 55.0, azimuth)
    weight = weight * smoothstep(ROWS - 2.0, ROW_CHIN + 3.0, row)
    y, z = points[:, 1] + 22.0, points[:, 2] - 6.0
    a = np.radians(angle_deg)
    turned = np.stack(
        [0 * y, y * np.cos(a) - z * np.sin(a) - y, z * np.cos(a) + y * np.sin(a) - z], axis=1
    )
    return _to_vertices(weight, len(points))[:, None] * turned


def _eyes_closed() -> np.ndarray:
    """The upper lids slide over the eyeballs to the lower ones."""
    points = neutral_mesh().vertices
    grid = points[grid_vertices()]
    azimuth = face_azimuth_deg()
    eye = np.abs(np.abs(azimuth) - EYE_AZIMUTH_DEG) / EYE_HALF_DEG
    weight = smoothstep(1.15, 0.8, eye)
    crease = ROW_LID_UP - 7
    moved = grid.copy()
    upper, lower = grid[ROW_LID_UP], grid[ROW_LID_LOW]
    margin = upper + 0.86 * (lower - upper)
    for row in range(crease + 1, ROW_LID_LOW):
        if row <= ROW_LID_UP:
            part = (row - crease) / (ROW_LID_UP - crease)
            place = grid[crease] * (1 - part) + margin * part
            depth = 1.4
        else:
            part = (row - ROW_LID_UP) / (ROW_LID_LOW - ROW_LID_UP)
            place = margin * (1 - part) + lower * part
            depth = 0.9
        centre = EYE_CENTRE_MM * np.stack(
            [np.sign(azimuth), np.ones(COLUMNS + 1), np.ones(COLUMNS + 1)], axis=1
        )
        offset = place - centre
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        moved[row] = centre + offset / distance * np.maximum(distance, EYE_RADIUS_MM + depth)
    return _to_vertices((moved - grid) * weight[None, :, None], len(points))
