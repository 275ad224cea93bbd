"""Vectors of length 1."""

from __future__ import annotations

import numpy as np


def unit(vectors: np.ndarray, shortest: float = 1e-12) -> np.ndarray:
    """The same directions at length 1.

    Args:
        vectors: (..., k) floats.
        shortest: a vector that is not longer has no direction.

    Returns:
        (..., k) of the same type; zero where there is no direction or a value is not finite.
    """
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    good = (length > shortest) & (length < np.inf)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=good)
