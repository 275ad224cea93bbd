"""Half floats against numpy's own conversion, bit for bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.formats import half
from lightstage.formats.half import float_from_half


def half_from_float(values):
    """The rounded values; what is too large is told as numpy's largest finite value tells it."""
    found, fits = half.half_from_float(values)
    wide = np.abs(np.asarray(values, np.float64))
    assert fits == (not (wide > 65504).any())
    return found


EVERY = np.arange(1 << 16, dtype=np.uint16).view(np.float16)


def test_every_half_float_widens_as_numpy_widens_it():
    wide, finite = float_from_half(EVERY.reshape(256, 256))
    assert wide.dtype == np.float32
    assert wide.shape == (256, 256)
    assert np.array_equal(wide.ravel(), EVERY.astype(np.float32), equal_nan=True)
    assert not finite
    assert float_from_half(EVERY[np.isfinite(EVERY)])[1]
    assert not float_from_half(np.array([1, np.inf], np.float16))[1]
    assert not float_from_half(np.array([np.nan, 1], np.float16))[1]


def test_half_floats_come_back_and_what_lies_between_rounds_to_even():
    known = EVERY[~np.isnan(EVERY)]
    wide = known.astype(np.float32)
    assert np.array_equal(half_from_float(wide).view(np.uint16), known.view(np.uint16))
    between = 0.5 * (wide[1:0x7C00] + wide[: 0x7C00 - 1])
    for values in (between, np.nextafter(between, np.float32(9)), -between):
        assert np.array_equal(half_from_float(values), values.astype(np.float16))


@given(st.floats(width=32), st.sampled_from([1e-8, 1e-6, 1e-3, 1.0, 1e3, 1e6]))
def test_any_float_rounds_as_numpy_rounds_it(value, scale):
    with np.errstate(over="ignore"):
        values = np.array([value, np.float32(value) * np.float32(scale)], np.float32)
        truth = values.astype(np.float16)
    assert np.array_equal(half_from_float(values), truth, equal_nan=True)
    finite = np.isfinite(truth)
    assert np.array_equal(np.signbit(half_from_float(values))[finite], np.signbit(truth)[finite])


@pytest.mark.parametrize("shape", [(0,), (3, 0, 2), (2, 3, 3)])
def test_shapes_and_strides_are_kept(shape):
    values = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    assert half_from_float(values).shape == shape
    assert np.array_equal(float_from_half(values.astype(np.float16))[0], values)
    turned = np.ascontiguousarray(values.T).T
    assert np.array_equal(half_from_float(turned), values.astype(np.float16))
