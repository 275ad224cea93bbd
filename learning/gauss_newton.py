"""Least squares by damped Gauss-Newton steps [Marquardt1963]."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

FIRST_DAMPING, MOST_DAMPING = 1e-3, 1e6
STRONGER, WEAKER = 8.0, 5.0
"""Factor on the damping after a step that was not taken, and its divisor after one that was."""
LEAST_DAMPING = 1e-9
LEAST_COST = 1e-12
"""A share of the cost is taken of this at least."""

Place = TypeVar("Place")


def descended(
    here: Place,
    equations: Callable[[Place], tuple[float, np.ndarray, np.ndarray]],
    moved: Callable[[Place, np.ndarray], Place],
    steps: int,
    *,
    least_gain: float = 0.0,
    least_step: float = 0.0,
    least_damping: float = LEAST_DAMPING,
) -> tuple[Place, float, np.ndarray]:
    """The place to which damped steps lead as long as the cost falls.

    A step is taken where it lowers the cost. Otherwise the next one is damped more, and the search
    ends where even `MOST_DAMPING` does not help.

    Args:
        here: where to begin.
        equations: cost, (u, u) normal matrix and (u,) half the gradient at a place.
        moved: a place after a step (u,).
        steps: number of steps at most, those that are not taken among them.
        least_gain: a step that lowers the cost by less than this share is the last; 0 for none.
        least_step: a step that moves no unknown by as much is the last; 0 for none.
        least_damping: share of the matrix's diagonal that is added to it, at least.

    Returns:
        The place, and its cost and normal matrix.
    """
    damping = FIRST_DAMPING
    cost, matrix, slope = equations(here)
    for _ in range(steps):
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), -slope)
        there = moved(here, step)
        new_cost, new_matrix, new_slope = equations(there)
        if not new_cost < cost:
            damping *= STRONGER
            if damping > MOST_DAMPING:
                break
            continue
        gain = (cost - new_cost) / max(cost, LEAST_COST)
        here, cost, matrix, slope = there, new_cost, new_matrix, new_slope
        damping = max(damping / WEAKER, least_damping)
        if gain < least_gain or np.abs(step).max() < least_step:
            break
    return here, cost, matrix
