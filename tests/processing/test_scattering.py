"""Light that wanders inside the skin: uniform fields stay, energy is kept."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.refinement.scattering import VARIANCES_MM2, WEIGHTS, scattered, unscattered

AMOUNTS = st.sampled_from([0.0, 0.25, 0.5, 1.0])


def leaving(
    irradiance: np.ndarray, mask: np.ndarray, px_per_mm: float, amount: float
) -> np.ndarray:
    """(n, P, 3) what leaves each pixel in all."""
    found = scattered(irradiance.astype(np.float32), mask, px_per_mm, amount)
    return np.asarray(found.kept * irradiance[:, :, None] + found.rest)


@given(
    seed=st.integers(0, 2**31),
    px_per_mm=st.floats(0.1, 8.0),
    amount=AMOUNTS,
    power=st.integers(-6, 6),
)
@settings(max_examples=30, deadline=None)
def test_uniform_light_stays_uniform_to_the_masks_edge(
    seed: int, px_per_mm: float, amount: float, power: int
) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=(40, 50)) > rng.uniform(0.2, 0.99)
    mask[20, 20] = True
    light = 10.0**power * np.array([1.0, 0.3])
    found = leaving(np.tile(light, (int(mask.sum()), 1)), mask, px_per_mm, amount)
    known = np.tile(light[:, None], (1, 3))
    np.testing.assert_allclose(found, np.tile(known, (len(found), 1, 1)), rtol=1e-3)


def test_a_lone_pixel_keeps_its_light_however_fine_the_picture() -> None:
    mask = np.zeros((60, 60), bool)
    mask[30, 30] = mask[2, 2] = True
    found = leaving(np.ones((2, 1)), mask, 30.0, 1.0)
    np.testing.assert_allclose(found, 1.0, rtol=1e-3)


@pytest.mark.parametrize("amount", [0.25, 0.75, 1.0])
def test_light_that_wanders_is_neither_lost_nor_made(amount: float) -> None:
    mask = np.ones((120, 120), bool)
    spot = np.full((120, 120), 1.0)
    spot[55:65, 50:60] = 5.0
    light = spot[mask][:, None]
    found = leaving(light, mask, 3.0, amount)
    np.testing.assert_allclose(found.sum(axis=0)[0], light.sum(), rtol=1e-4)
    assert (found > 0.999).all()
    assert (found < 5.001).all()


def test_red_wanders_farther_than_blue() -> None:
    mask = np.ones((80, 80), bool)
    edge = np.ones((80, 80))
    edge[:, 40:] = 0.1
    found = leaving(edge[mask][:, None], mask, 4.0, 1.0).reshape(80, 80, 3)
    slope = -np.diff(found[40], axis=0).min(axis=0)
    assert 0 < slope[0] < slope[1] < slope[2] < 0.9


def test_a_spot_spreads_by_the_profiles_own_variance() -> None:
    """In an open field the second moment of what leaves is the mean of the Gaussians'."""
    px_per_mm, size = 3.0, 161
    mask = np.ones((size, size), bool)
    base = np.ones((size, size))
    spot = base.copy()
    spot[80, 80] = 1001.0
    found = leaving(spot[mask][:, None], mask, px_per_mm, 1.0) - leaving(
        base[mask][:, None], mask, px_per_mm, 1.0
    )
    found = found.reshape(size, size, 3) / 1000
    line = np.arange(size) - 80
    moment = np.einsum("xyc,x->c", found, line**2.0)
    share = WEIGHTS / WEIGHTS.sum(axis=0)
    wide = np.sqrt(VARIANCES_MM2) * px_per_mm >= 0.25
    known = (share[wide] * np.array(VARIANCES_MM2)[wide, None]).sum(axis=0) * px_per_mm**2
    np.testing.assert_allclose(moment, known, rtol=0.05)


def test_no_amount_and_narrow_profiles_leave_light_where_it_entered() -> None:
    mask = np.ones((9, 9), bool)
    light = np.random.default_rng(0).uniform(0, 1, (81, 2)).astype(np.float32)
    for found in (unscattered(81, 2), scattered(light, mask, 5.0, 0.0)):
        np.testing.assert_array_equal(found.kept, 1)
        assert not found.rest.any()
    # At .05 pixels a millimetre all Gaussians stay within their pixel.
    coarse = scattered(light, mask, 0.05, 1.0)
    np.testing.assert_allclose(coarse.kept, 1, rtol=1e-12)
    assert not coarse.rest.any()


@given(
    values=st.lists(
        st.floats(0, 1e6, width=32) | st.sampled_from([0.0, 1e-30, 1e-6]), min_size=12, max_size=12
    ),
    px_per_mm=st.floats(0.01, 30),
    amount=AMOUNTS,
)
@settings(max_examples=40, deadline=None)
def test_whatever_enters_what_leaves_is_finite_and_no_more_than_the_brightest(
    values: list[float], px_per_mm: float, amount: float
) -> None:
    mask = np.zeros((6, 7), bool)
    mask[1:5, 2:5] = True
    light = np.array(values)[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scattered(light.astype(np.float32), mask, px_per_mm, amount)
    assert np.isfinite(found.rest).all()
    assert (found.kept >= 0).all()
    assert (found.kept <= 1 + 1e-9).all()
    assert not found.rest[light[:, 0] == 0].any()
    out = found.kept * light[:, :, None] + found.rest
    assert out.max() <= light.max() * 1.001
    assert out.min() >= -1e-4 * light.max()
