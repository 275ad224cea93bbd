"""The error expected of a refined albedo: its plain twin, its bounds, and what it rises with."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.whole.expected import GAP_ERROR, MARGIN, expected_error, expected_of_refined


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 999),
    albedo=st.sampled_from([0.0, 1e-6, 0.2, 1.0, 1e6]),
    deviation=st.sampled_from([0.0, 1e-6, 0.1, 10.0]),
)
def test_errors_are_finite_and_never_below_what_the_network_expects(
    seed: int, albedo: float, deviation: float
) -> None:
    rng = np.random.default_rng(seed)
    image = (albedo * rng.random((12, 8, 3))).astype(np.float32)
    known = rng.random((12, 8)) > 0.5
    answer = np.log(np.maximum(rng.random((6, 4, 3)), 1e-6))
    error = expected_error(np.full((6, 4), deviation), (12, 8))
    assert error == pytest.approx(np.full((12, 8), MARGIN * deviation), rel=1e-5)
    found = expected_of_refined(error, image, answer, known)
    assert found.shape == (12, 8)
    assert np.isfinite(found).all()
    least = MARGIN * np.hypot(np.where(known, 0.0, GAP_ERROR), deviation)
    assert (found >= (1 - 1e-6) * least - 1e-6).all()


def test_a_texel_that_was_refined_to_what_the_network_had_is_as_sure_as_it_was() -> None:
    answer = np.full((6, 4, 3), np.log(0.3))
    image = np.full((12, 8, 3), 0.3, np.float32)
    known = np.ones((12, 8), bool)
    error = expected_error(np.full((6, 4), 0.02 / MARGIN), (12, 8))
    found = expected_of_refined(error, image, answer, known)
    assert found == pytest.approx(np.full((12, 8), 0.02), rel=1e-3)
    image[3, 3] = 0.05
    known[9, 5] = False
    changed = expected_of_refined(error, image, answer, known)
    assert changed[3, 3] > 0.3
    assert changed[9, 5] == pytest.approx(math.hypot(0.02, MARGIN * GAP_ERROR), rel=1e-3)
    changed[3, 3] = changed[9, 5] = 0.02
    assert changed == pytest.approx(found, rel=1e-3)
