"""Hot pixels, which read as bright in the dark, replaced by their neighbours of the same colour."""

from __future__ import annotations

import numpy as np


def mend(values: np.ndarray, hot: np.ndarray, near: np.ndarray | None = None) -> None:
    """Replace hot pixels by the median of the four nearest of their colour, in place.

    Neighbours that are hot themselves do not count, unless all are.

    Args:
        values: (h, w) of a mosaic of 2 x 2 pixels, as the sensor reads it.
        hot: (n, 2) int row, column of all hot pixels; those beyond `values` are left out.
        near: (n,) bool, which of them are replaced; None for all.
    """
    height, width = values.shape
    known = set(map(tuple, hot.tolist()))
    inside = (hot < (height, width)).all(axis=1)
    for row, column in hot[inside if near is None else inside & near].tolist():
        around = [
            (row + down, column + right)
            for down, right in ((-2, 0), (2, 0), (0, -2), (0, 2))
            if 0 <= row + down < height and 0 <= column + right < width
        ]
        sound = [place for place in around if place not in known] or around
        if sound:
            values[row, column] = np.median([values[place] for place in sound])
