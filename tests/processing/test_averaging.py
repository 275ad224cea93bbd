"""Readings averaged over neighbouring pixels, beside a plain float64 mean."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.refinement.averaging import CALM, NOISY_SIDE, SIDE, averaged, averaged_side
from processing.refinement.scene import View
from processing.surface import Sight

PATTERNS = 2


def view_of(mask: np.ndarray, rgb: np.ndarray, usable: np.ndarray) -> View:
    """A view of (h, w) pixels of which nothing but the readings matters."""
    nothing = np.zeros((len(rgb), 3))
    sight = Sight(mask, nothing, nothing, nothing, nothing[:, 0], None, np.zeros(mask.shape))  # type: ignore[arg-type]
    return View(sight, rgb, np.zeros(len(rgb)), usable, 1.0, np.ones((4, 1)), np.ones((1, 1)))


def twin(view: View, side: int) -> np.ndarray:
    """The same by a loop over pixels."""
    places = np.argwhere(view.sight.mask)
    out = view.rgb.astype(float)
    for i, place in enumerate(places):
        near = (np.abs(places - place) <= side // 2).all(axis=1) & view.usable
        if view.usable[i]:
            out[i] = view.rgb[near].astype(float).mean(axis=0)
    return out


@given(seed=st.integers(0, 10_000), side=st.sampled_from([3, 5]), power=st.floats(-6, 6))
@settings(max_examples=40, deadline=None)
def test_means_are_those_of_a_loop_over_usable_pixels(seed: int, side: int, power: float) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=rng.integers(1, 9, size=2)) < 0.7
    count = int(mask.sum())
    rgb = (10**power * rng.normal(0.3, 0.2, (count, PATTERNS, 3))).astype(np.float32)
    usable = rng.uniform(size=count) < 0.7
    rgb[~usable] = rng.choice([0, np.nan, np.inf, 1e30], (int((~usable).sum()), PATTERNS, 3))
    view = view_of(mask, rgb, usable)
    found = averaged(view, side).rgb
    np.testing.assert_allclose(found, twin(view, side), rtol=1e-4, atol=10**power * 1e-5)
    assert found.dtype == np.float32
    assert np.isfinite(found[usable]).all()


def test_the_given_view_is_not_changed() -> None:
    rgb = np.arange(9 * PATTERNS * 3, dtype=np.float32).reshape(9, PATTERNS, 3)
    view = view_of(np.ones((3, 3), bool), rgb.copy(), np.ones(9, bool))
    found = averaged(view, 3)
    assert (view.rgb == rgb).all()
    assert dataclasses.replace(found, rgb=view.rgb).sight is view.sight
    np.testing.assert_allclose(found.rgb[4], rgb.mean(axis=0), rtol=1e-6)


@pytest.mark.parametrize(("noise", "side"), [(0.0, SIDE), (CALM, SIDE), (0.02, NOISY_SIDE)])
def test_noisier_readings_are_averaged_over_more_pixels(noise: float, side: int) -> None:
    assert averaged_side(noise) == side
