"""Small pictures of large ones: means over cells, straight from half floats."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit, prange

from processing.frames.halves import as_float


def shrunk(picture: np.ndarray, cell: int) -> np.ndarray:
    """Means over square cells; a cell with a value that is not finite becomes 0.

    Args:
        picture: (h, w) or (h, w, 3), halves or other floats.
        cell: pixels a side; rows and columns that fill no cell are dropped.

    Returns:
        (h // cell, w // cell) or (.., 3) float32, finite.
    """
    height, width = picture.shape[0] // cell, picture.shape[1] // cell
    part = picture[: height * cell, : width * cell]
    if part.dtype == np.float16 and part.ndim == 3:
        small = np.zeros((height, width, part.shape[2]), np.float32)
        _shrink_halves(np.ascontiguousarray(part).view(np.uint16), cell, small)
    else:
        small = np.asarray(part, np.float32)
        if cell > 1:
            small = cv2.resize(small, (width, height), interpolation=cv2.INTER_AREA)
    return np.nan_to_num(small, nan=0.0, posinf=0.0, neginf=0.0)


@njit(parallel=True, cache=True)
def _shrink_halves(bits: np.ndarray, cell: int, out: np.ndarray) -> None:
    share = np.float32(1 / (cell * cell))
    for y in prange(out.shape[0]):
        for row in range(y * cell, (y + 1) * cell):
            for x in range(out.shape[1]):
                for column in range(x * cell, (x + 1) * cell):
                    for c in range(out.shape[2]):
                        out[y, x, c] += as_float(bits[row, column, c])
        for x in range(out.shape[1]):
            for c in range(out.shape[2]):
                out[y, x, c] *= share
