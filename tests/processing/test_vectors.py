"""Vectors of length 1: exact, of their own type, and zero where there is no direction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from processing.vectors import unit


def plain(vector, shortest):
    length = float(np.sqrt(sum(float(each) ** 2 for each in vector)))
    return [each / length for each in vector] if shortest < length < np.inf else [0.0] * len(vector)


NUMBERS = st.one_of(
    st.floats(-1e100, 1e100), st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e-300, -1e300])
)


@given(st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=1, max_size=8))
def test_lengths_are_one_or_nothing(rows):
    vectors = np.array(rows)
    with np.errstate(over="ignore", invalid="ignore"):
        found = unit(vectors)
    assert np.isfinite(found).all()
    for row, own in zip(rows, found, strict=True):
        if np.isfinite(row).all() and max(map(abs, row)) < 1e150:
            assert own == pytest.approx(plain(row, 1e-12), abs=1e-12)


def test_the_type_stays_and_what_is_shorter_has_no_direction():
    vectors = np.array([[[3e-3, 4e-3, 0.0]], [[0.0, 2.0, 0.0]]], np.float32)
    found = unit(vectors, shortest=1e-2)
    assert found.dtype == np.float32
    assert found.tolist() == [[[0.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]]
