"""An expression's left and right side, for programs that drive each by itself."""

from __future__ import annotations

import numpy as np

MIDDLE_MM = 12.0
"""Half the width of the middle, where one side of a split expression fades into the other."""


def left_share(x_mm: np.ndarray) -> np.ndarray:
    """(n,) share of a vertex's offset that the left side has; the right side has the rest.

    Args:
        x_mm: (n,) places of the vertices in the head frame, left of the head above 0.
    """
    return rising(x_mm, -MIDDLE_MM, MIDDLE_MM)


def rising(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, smooth between."""
    share = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share))
