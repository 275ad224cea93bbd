"""Which of many light states must be computed: light is linear, so the others are sums."""

from __future__ import annotations

import numpy as np
from scipy import linalg

TOLERANCE = 1e-9
"""Relative residual below which a state is taken for a sum of others."""


def independent(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States that span all, and how the others follow from them.

    Args:
        states: (s, k) weights of all lamps; a gradient's complement is full minus it.

    Returns:
        (b,) ascending indices of independent states, and (s, b) coefficients, the identity on
        those.
    """
    states = np.asarray(states, float)
    if not states.size or not states.any():
        return np.zeros(0, np.int64), np.zeros((len(states), 0))
    _, triangle, order = linalg.qr(states.T, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    chosen = np.sort(order[: int((sizes > TOLERANCE * sizes[0]).sum())])
    return chosen, combine(states, states[chosen])


def combine(states: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(s, b) coefficients of states (s, k) over known, independent ones (b, k).

    NaN fills the row of a state that is no such sum.
    """
    states = np.asarray(states, float)
    if not len(known):
        return np.where(states.any(axis=1, keepdims=True), np.nan, 0.0)[:, :0]
    coefficients = np.linalg.lstsq(known.T, states.T, rcond=None)[0].T
    whole = np.round(coefficients)
    coefficients = np.where(np.abs(coefficients - whole) < TOLERANCE, whole, coefficients)
    apart = np.abs(coefficients @ known - states).max(axis=1)
    coefficients[apart > 1e3 * TOLERANCE * np.abs(known).max()] = np.nan
    return coefficients
