"""Small pictures of large ones: means over cells, and which cells can be used."""

from __future__ import annotations

import cv2
import numpy as np

from processing.frames.small import cell_means


def shrunk(picture: np.ndarray, cell: int) -> np.ndarray:
    """Means over square cells; a cell with a value that is not finite becomes 0.

    Args:
        picture: (h, w, 3), halves or other floats.
        cell: pixels a side; rows and columns that fill no cell are dropped.

    Returns:
        (h // cell, w // cell, 3) float32, finite.
    """
    height, width = picture.shape[0] // cell, picture.shape[1] // cell
    part = picture[: height * cell, : width * cell]
    if part.dtype == np.float16:
        small = cell_means(part, cell)
    else:
        small = np.asarray(part, np.float32)
        if cell > 1:
            small = cv2.resize(small, (width, height), interpolation=cv2.INTER_AREA)
    return np.nan_to_num(small, nan=0.0, posinf=0.0, neginf=0.0)


def free_cells(usable: np.ndarray, cell: int) -> np.ndarray:
    """(h // cell, w // cell) bool: cells all of whose pixels are usable.

    Args:
        usable: (h, w) bool.
        cell: pixels a side.
    """
    height, width = usable.shape[0] // cell, usable.shape[1] // cell
    out = np.ones((height, width), bool)
    rows, columns = np.divmod(np.flatnonzero(~usable), usable.shape[1])
    rows, columns = rows // cell, columns // cell
    inside = (rows < height) & (columns < width)
    out[rows[inside], columns[inside]] = False
    return out
