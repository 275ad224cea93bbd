"""The point nearest to lines, against a plain least squares over their rows."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lightstage.nearest_point import nearest_equations


@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-6, 1.0, 1e6]), count=st.integers(2, 9))
def test_the_nearest_point_is_that_of_a_plain_least_squares(seed, scale, count):
    rng = np.random.default_rng(seed)
    origins, directions = scale * rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rows = [np.eye(3) - np.outer(d, d) for d in directions]
    right = [row @ o for row, o in zip(rows, origins, strict=True)]
    plain = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    matrix, b = nearest_equations(origins, directions)
    np.testing.assert_allclose(matrix @ plain, b, atol=1e-9 * scale)


def test_parallel_lines_leave_one_direction_open_and_none_leave_all():
    matrix, _ = nearest_equations(np.eye(3)[:2], np.array([[0.0, 0, 1], [0.0, 0, 1]]))
    np.testing.assert_allclose(np.linalg.eigvalsh(matrix), [0, 2, 2], atol=1e-12)
    matrix, b = nearest_equations(np.zeros((0, 3)), np.zeros((0, 3)))
    assert not matrix.any()
    assert not b.any()
