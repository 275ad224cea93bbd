"""Maps of pixels as pictures: what a mask leaves out, and how half floats round."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.view_maps import pasted


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    shape=st.tuples(st.integers(0, 9), st.integers(0, 9)),
    channels=st.sampled_from([(), (1,), (3,)]),
    share=st.sampled_from([0.0, 0.3, 1.0]),
    scale=st.sampled_from([1e-8, 1e-6, 1e-3, 1.0, 1e3, 1e6]),
    odd=st.sampled_from([0.0, np.nan, np.inf, -np.inf, 65519.9, 65520.0]),
)
def test_values_lie_where_the_mask_is_true_and_round_as_numpys(
    seed, shape, channels, share, scale, odd
):
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=shape) < share
    values = (scale * rng.normal(size=(mask.sum(), *channels))).astype(np.float32)
    values.reshape(-1)[: values.size // 3] = odd
    right = np.zeros((*shape, *channels), np.float16)
    with np.errstate(over="ignore"):
        right[mask] = values.astype(np.float16)
    found = pasted(mask, values)
    assert found.dtype == np.float16
    assert np.array_equal(found, right, equal_nan=True)
    assert np.array_equal(pasted(np.asfortranarray(mask), values), right, equal_nan=True)


def test_a_mask_of_other_pixels_is_refused():
    with pytest.raises(ValueError, match="3 values for a mask of 4"):
        pasted(np.ones((2, 2), bool), np.ones(3, np.float32))
