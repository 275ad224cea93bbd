"""How faces move: displacements of the neutral head, and of anyone's where lids must meet."""

from __future__ import annotations

import functools

import numpy as np

from sim.head.eyes import clear_of_eyes, close_lids, eye_centres, seat_balls
from sim.head.fields import leave_eyes_round, paired
from sim.head.grid import (
    MOUTH_HALF_DEG,
    ROW_CHIN,
    ROW_MOUTH,
    ROWS,
    face_azimuth_deg,
    smoothstep,
)
from sim.head.mesh import grid_vertices, neutral_mesh

EXPRESSIONS = ("smile", "jaw_open", "brow_raise", "brow_furrow", "pucker", "eyes_closed")


@functools.cache
def expression_modes() -> np.ndarray:
    """(len(EXPRESSIONS), n, 3) displacements of the neutral head in mm at full strength."""
    modes = np.stack([_moved(name, neutral_mesh().vertices) for name in EXPRESSIONS])
    modes.flags.writeable = False
    return modes


def expressed(vertices: np.ndarray, expression: str) -> np.ndarray:
    """A person's vertices with an expression.

    What moves by muscles moves as in `expression_modes`; lids close over this person's own eyes,
    and jaws turn about this person's own joints.

    Args:
        vertices: (n, 3) mm of a person of the model, with open lids and a closed mouth.
        expression: one of `EXPRESSIONS`.

    Returns:
        (n, 3) mm.
    """
    index = grid_vertices()
    out = vertices + _moved(expression, vertices)
    neutral = neutral_mesh().vertices[index]
    centres = eye_centres(vertices[index], neutral)
    grid = clear_of_eyes(out[index], centres)
    out[index] = grid if expression == "eyes_closed" else seat_balls(grid, centres)
    return out


def _moved(name: str, vertices: np.ndarray) -> np.ndarray:
    neutral = neutral_mesh().vertices
    if name == "eyes_closed":
        index = grid_vertices()
        grid = vertices[index]
        moved = close_lids(grid, eye_centres(grid, neutral[index]))
        out = np.zeros_like(vertices)
        out[index] = moved
        # Brows come down a little.
        return out + leave_eyes_round(
            paired(neutral, ((0, -1.0, 0), (34, 16, 84), (24, 6, 22))), rigid=False
        )
    if name == "jaw_open":
        return leave_eyes_round(_jaw_open(vertices), rigid=False)
    return leave_eyes_round(_MUSCLES[name](neutral), rigid=False)


def _smile(points: np.ndarray) -> np.ndarray:
    return paired(
        points,
        ((8.5, 0.5, -5.5), (25, -74, 84), (11, 10, 20)),  # corners out and back
        ((0, 6.5, 0), (31, -73, 80), (9, 10, 20)),  # and up
        ((0, -0.8, 0), (0, -76, 96), (10, 8, 18)),
        ((0, 0.6, -1.8), (0, -72, 98), (13, 9, 18)),  # lips thin against the teeth
        ((1.8, 4.5, 4.2), (39, -41, 74), (13, 11, 20)),  # cheeks rise and round
        ((1.0, 0, -1.8), (30, -58, 84), (4.5, 9, 14)),  # fold from nose to mouth
        ((0, 1.5, 0.5), (32, -19, 79), (13, 4.5, 18)),  # lower lids
        ((0, -0.5, 0), (32, -3, 80), (13, 3, 18)),
        ((1.6, 1.0, 0), (14, -47, 96), (7, 8, 14)),  # wings of the nose
        ((1.5, 0.8, 0.8), (47, -84, 40), (16, 14, 24)),
    )


def _brow_raise(points: np.ndarray) -> np.ndarray:
    return paired(
        points,
        ((0, 6.5, 0.5), (32, 17, 84), (28, 9, 26)),
        ((0, 3.0, -0.5), (0, 36, 92), (45, 14, 30)),
        ((0, 1.2, 0.2), (31, -2, 80), (13, 3.2, 18)),
        ((0, -0.5, 0), (31, -16, 79), (13, 4.0, 18)),
    )


def _brow_furrow(points: np.ndarray) -> np.ndarray:
    return paired(
        points,
        ((-4.2, -4.2, 1.2), (15, 14, 92), (11, 8, 18)),
        ((0, -2.8, 0.4), (36, 15, 84), (16, 7, 18)),
        ((0, -1.2, 0), (29, -2, 80), (13, 3.5, 18)),
        ((0, 0.9, 0.3), (31, -18, 79), (12, 4.0, 18)),
        ((0.6, 1.2, 0), (13, -46, 97), (7, 7, 14)),
        ((0, 0, -0.8), (0, -72, 98), (20, 6, 18)),  # lips pressed
        ((0, -0.8, 0), (24, -75, 84), (9, 7, 16)),
    )


def _pucker(points: np.ndarray) -> np.ndarray:
    return paired(
        points,
        ((-8.0, 0, 4.0), (25, -74, 84), (12, 11, 22)),
        ((-2.0, 0, 2.0), (12, -74, 94), (8, 9, 18)),
        ((0, 0, 6.5), (0, -74, 95), (16, 11, 24)),
        ((0, 1.4, 0.8), (0, -67, 97), (13, 4.5, 18)),
        ((0, -1.4, 0.8), (0, -81, 96), (13, 4.5, 18)),
        ((-1.5, 0, -1.8), (42, -66, 66), (11, 14, 20)),  # cheeks drawn in
    )


_MUSCLES = {
    "smile": _smile,
    "brow_raise": _brow_raise,
    "brow_furrow": _brow_furrow,
    "pucker": _pucker,
}


def _jaw_open(points: np.ndarray, angle_deg: float = 13.0) -> np.ndarray:
    """The jaw turns about the axis through its joints; the lips part at the mouth's row."""
    azimuth = np.abs(face_azimuth_deg())
    row = np.arange(ROWS + 1.0)[:, None]
    mouth = np.clip(azimuth / MOUTH_HALF_DEG, 0, 1)
    width = 0.5 + 8.0 * (1 - np.sqrt(1 - mouth**2))
    width = width + 20.0 * smoothstep(MOUTH_HALF_DEG, 60.0, azimuth) + 0 * row
    weight = smoothstep(-1.0, 1.0, (row - ROW_MOUTH) / width)
    weight = weight * smoothstep(95.0, 55.0, azimuth)
    weight = weight * smoothstep(ROWS - 2.0, ROW_CHIN + 3.0, row)
    by_vertex = np.empty(len(points))
    by_vertex[grid_vertices()] = weight
    y, z = points[:, 1] + 22.0, points[:, 2] - 6.0
    a = np.radians(angle_deg)
    turned = np.stack(
        [0 * y, y * np.cos(a) - z * np.sin(a) - y, z * np.cos(a) + y * np.sin(a) - z], axis=1
    )
    # The cheeks are drawn in, the corners of the mouth toward each other.
    drawn = paired(points, ((-2.6, 0, -1.0), (36, -70, 72), (16, 18, 24)))
    # The row between the lips goes in between the teeth, where it is dark.
    inward = np.zeros_like(points)
    for row_inside, depth_mm in ((ROW_MOUTH - 1, 3.0), (ROW_MOUTH, 24.0), (ROW_MOUTH + 1, 3.0)):
        inward[grid_vertices()[row_inside], 2] = -depth_mm * np.clip(1 - (mouth / 0.9) ** 2, 0, 1)
    return by_vertex[:, None] * turned + drawn + inward
