"""The error expected of a refined albedo: its plain twin, its bounds, and what it rises with."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.checkpoint import load_whole_face, shipped_weights
from learning.whole.expected import (
    ENCODED_PER_LOG,
    GAP_ERROR,
    OWN_SHARE,
    doubt_of,
    expected_error,
    expected_of_refined,
    log_deviation,
)


def plain_deviation(modes: np.ndarray, covariance: np.ndarray) -> list[float]:
    """`log_deviation` in plain Python."""
    found = []
    for texel in modes:
        count = len(covariance)
        mean = [sum(float(texel[c][k]) for c in range(3)) / 3 for k in range(count)]
        total = sum(
            mean[k] * float(covariance[k][m]) * mean[m] for k in range(count) for m in range(count)
        )
        found.append(math.sqrt(max(total, 0.0)))
    return found


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 999),
    count=st.integers(1, 5),
    scale=st.sampled_from([0.0, 1e-6, 1e-3, 1.0, 1e3, 1e6]),
)
def test_deviations_are_those_of_the_plain_twin(seed: int, count: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    modes = rng.normal(size=(6, 3, count))
    root = scale * rng.normal(size=(count, count))
    found = log_deviation(modes, root @ root.T)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, plain_deviation(modes, root @ root.T), rtol=1e-9, atol=1e-12)


def test_a_covariance_that_rounding_made_negative_gives_zero() -> None:
    assert log_deviation(np.ones((2, 3, 1)), np.array([[-1e-18]])).tolist() == [0.0, 0.0]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 999),
    albedo=st.sampled_from([0.0, 1e-6, 0.2, 1.0, 1e6]),
    deviation=st.sampled_from([0.0, 1e-6, 0.1, 10.0]),
)
def test_errors_are_finite_and_never_below_what_is_left_open(
    seed: int, albedo: float, deviation: float
) -> None:
    rng = np.random.default_rng(seed)
    image = (albedo * rng.random((12, 8, 3))).astype(np.float32)
    known = rng.random((12, 8)) > 0.5
    answer = np.log(np.maximum(rng.random((6, 4, 3)), 1e-6))
    error = expected_error(np.full((6, 4), deviation), np.zeros((6, 4)), (12, 8))
    assert error == pytest.approx(np.full((12, 8), ENCODED_PER_LOG * deviation), rel=1e-5)
    found = expected_of_refined(error, image, answer, known)
    assert found.shape == (12, 8)
    assert np.isfinite(found).all()
    least = np.where(known, 0.0, GAP_ERROR) ** 2 + (ENCODED_PER_LOG * deviation) ** 2
    assert (found >= np.sqrt(least) - 1e-6).all()


def test_a_texel_that_was_refined_to_what_the_network_had_is_as_sure_as_its_light() -> None:
    answer = np.full((6, 4, 3), np.log(0.3))
    image = np.full((12, 8, 3), 0.3, np.float32)
    known = np.ones((12, 8), bool)
    error = expected_error(np.full((6, 4), 0.04), np.zeros((6, 4)), (12, 8))
    found = expected_of_refined(error, image, answer, known)
    assert found == pytest.approx(np.full((12, 8), 0.02), rel=1e-3)
    image[3, 3] = 0.05
    known[9, 5] = False
    changed = expected_of_refined(error, image, answer, known)
    assert changed[3, 3] > 0.3
    assert changed[9, 5] == pytest.approx(math.hypot(0.02, GAP_ERROR), rel=1e-3)
    changed[3, 3] = changed[9, 5] = 0.02
    assert changed == pytest.approx(found, rel=1e-3)


def test_what_the_network_expects_of_a_place_is_added() -> None:
    own = np.zeros((6, 4))
    own[:, :2] = 0.1
    found = expected_error(np.zeros((6, 4)), own, (6, 4))
    assert found[:, 0] == pytest.approx(np.full(6, 0.1 * OWN_SHARE**0.5), rel=1e-5)
    assert not found[:, 3].any()


def test_the_shipped_network_doubts_a_persons_tone() -> None:
    network, _ = load_whole_face(shipped_weights())
    doubt = doubt_of(network)
    assert doubt.shape == (network.config.rows, network.config.columns)
    skin = doubt[doubt > 0]
    # Its tone has an error of .1 to .2 in the logarithm (docs/notes/photo.md).
    assert 0.05 < np.median(skin) < 0.4
