"""Fine detail of the specular albedo: its plain twin, and what it never does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.networks.whole_face import DARKEST
from learning.whole.specular_detail import MOST, SLOPE, WIDTH, specular_detail

ROWS, COLUMNS = 128, 84


def pored() -> np.ndarray:
    """Skin with a pore, and a shade that is wide."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    pore = np.exp(-((row - 64) ** 2 + (column - 40) ** 2) / 2.0)
    wide = 0.3 + 0.1 * row / ROWS
    return np.asarray((wide * (1 - 0.2 * pore))[..., None] * [1.0, 0.7, 0.5], np.float32)


def twin(albedo: np.ndarray, row: int, column: int) -> float:
    """The factor of one texel, by sums in plain Python."""
    sigma = WIDTH * len(albedo)
    reach = math.ceil(4 * sigma)
    total = weights = 0.0
    for y in range(row - reach, row + reach + 1):
        for x in range(column - reach, column + reach + 1):
            weight = math.exp(-((y - row) ** 2 + (x - column) ** 2) / (2 * sigma**2))
            value = sum(math.log(max(float(albedo[y, x, c]), DARKEST)) for c in range(3)) / 3
            total += weight * value
            weights += weight
    own = sum(math.log(max(float(albedo[row, column, c]), DARKEST)) for c in range(3)) / 3
    return math.exp(min(max(SLOPE * (own - total / weights), -MOST), MOST))


def test_the_factor_is_that_of_the_plain_twin() -> None:
    albedo = pored()
    found = specular_detail(albedo, np.ones((ROWS, COLUMNS), bool))
    for row, column in ((64, 40), (65, 41), (66, 40), (30, 20), (90, 60)):
        assert found[row, column] == pytest.approx(twin(albedo, row, column), rel=2e-3)


def test_a_pore_mirrors_less_and_what_is_wide_changes_nothing() -> None:
    found = specular_detail(pored(), np.ones((ROWS, COLUMNS), bool))
    assert found[64, 40] < 0.9
    assert np.abs(found[10:50, 10:-10] - 1).max() < 0.01
    assert found.mean() == pytest.approx(1, abs=0.01)


def test_what_is_not_covered_has_no_part() -> None:
    albedo, covered = pored(), np.ones((ROWS, COLUMNS), bool)
    covered[:, :30] = False
    before = specular_detail(albedo, covered)
    albedo[:, :30] = 1e-3
    after = specular_detail(albedo, covered)
    np.testing.assert_array_equal(before, after)
    np.testing.assert_array_equal(after[:, :30], 1.0)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 999),
    scale=st.sampled_from([0.0, 1e-6, 1e-3, 1.0, 1e6]),
    covered=st.sampled_from([0.0, 0.1, 1.0]),
)
def test_any_albedo_gives_bounded_factors(seed: int, scale: float, covered: float) -> None:
    rng = np.random.default_rng(seed)
    albedo = (scale * rng.random((48, 32, 3))).astype(np.float32)
    found = specular_detail(albedo, rng.random((48, 32)) < covered)
    assert np.isfinite(found).all()
    assert (np.abs(np.log(found)) <= MOST + 1e-6).all()
