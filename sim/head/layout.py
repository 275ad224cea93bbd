"""Where the head lies in its UV tile: the face in front, cuts behind (see `sim.head.unwrap`)."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

LAYOUT_PATH = Path(__file__).parents[1] / "data" / "layout.npz"


@functools.cache
def layout() -> np.ndarray:
    """(rows + 1, columns + 1, 2) float64 UV of each point of the vertex grid, 0..1, v upward."""
    with np.load(LAYOUT_PATH) as file:
        uv = np.asarray(file["uv"], np.float64)
    uv.flags.writeable = False
    return uv
