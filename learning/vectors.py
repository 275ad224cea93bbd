"""Vectors of arrays."""

from __future__ import annotations

import numpy as np

SHORTEST = 1e-12
"""A vector that is not longer has no direction."""


def unit(vectors: np.ndarray) -> np.ndarray:
    """(..., k) vectors of length 1, of the same type; those without a direction become zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > SHORTEST)
