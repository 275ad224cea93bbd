"""Damped Gauss-Newton steps: against SciPy's, and when they are taken and end."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from learning.gauss_newton import descended

Equations = tuple[float, np.ndarray, np.ndarray]


def valley(at: np.ndarray) -> np.ndarray:
    """(2,) residuals whose squares add up to Rosenbrock's function."""
    return np.array([10 * (at[1] - at[0] ** 2), 1 - at[0]])


def slopes_of_valley(at: np.ndarray) -> np.ndarray:
    return np.array([[-20 * at[0], 10.0], [-1.0, 0.0]])


def of_valley(at: np.ndarray) -> Equations:
    off, slopes = valley(at), slopes_of_valley(at)
    return float(off @ off), slopes.T @ slopes, slopes.T @ off


def plain(here: np.ndarray, step: np.ndarray) -> np.ndarray:
    return here + step


@settings(max_examples=30, deadline=None)
@given(st.integers(-30, 30), st.integers(-30, 30))
def test_the_least_squares_of_scipy_are_found_from_anywhere_in_a_bent_valley(
    tenths_x: int, tenths_y: int
) -> None:
    start = np.array([tenths_x, tenths_y]) / 10
    found, cost, matrix = descended(start, of_valley, plain, 300)
    known = least_squares(valley, start, slopes_of_valley, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(found, known.x, atol=1e-6)
    again = of_valley(found)
    assert cost == again[0]
    np.testing.assert_array_equal(matrix, again[1])


def test_the_cost_never_rises_and_each_place_follows_from_one_with_a_lower_cost() -> None:
    costs = [descended(np.array([-1.2, 1.0]), of_valley, plain, n)[1] for n in range(30)]
    assert costs[0] == of_valley(np.array([-1.2, 1.0]))[0]
    assert all(after <= before for before, after in itertools.pairwise(costs))
    assert costs[-1] < 1e-6 * costs[0]


@pytest.mark.parametrize("beyond", [np.nan, np.inf, 4.0])
def test_a_step_to_a_cost_that_is_not_lower_or_not_a_number_is_not_taken(beyond: float) -> None:
    start = np.array([2.0])

    def equations(at: np.ndarray) -> Equations:
        return (4.0 if at[0] == 2.0 else beyond), np.eye(1), at

    found, cost, _ = descended(start, equations, plain, 1000)
    assert (found[0], cost) == (2.0, 4.0)


def test_a_search_that_gains_nothing_ends_long_before_its_last_step() -> None:
    asked = []

    def equations(at: np.ndarray) -> Equations:
        asked.append(at)
        return 1.0, np.eye(1), np.ones(1)

    descended(np.zeros(1), equations, plain, 1000)
    assert len(asked) < 20


def test_a_small_gain_and_a_small_step_each_end_the_search() -> None:
    asked = []

    def equations(at: np.ndarray) -> Equations:
        asked.append(at[0])
        return float(at[0] ** 4), np.full((1, 1), 4 * at[0] ** 2), 2 * at**3

    def rounds(**ending: float) -> list[float]:
        asked.clear()
        descended(np.ones(1), equations, plain, 40, **ending)
        return list(asked)

    # Each step halves the place: the cost falls by 15 / 16 of itself.
    assert len(rounds()) == 41
    assert len(rounds(least_gain=0.95)) == 2
    assert len(rounds(least_gain=0.93)) > 10
    # Steps are 1/2, 1/4, 1/8, 1/16: the last one is the first below the limit.
    assert len(rounds(least_step=0.1)) == 5
