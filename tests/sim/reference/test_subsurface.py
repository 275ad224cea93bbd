"""Light inside the skin against what is known of Gaussians on a plane."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import erf

from sim.people.subject import Subject
from sim.reference.points import Skin
from sim.reference.subsurface import FINEST, PROFILE, VARIANCES_MM2, diffuse_inside, layer_step
from sim.reference.texels import Texels
from tests.sim.reference.surfaces import corner, plane


@pytest.fixture(scope="module")
def texels() -> Texels:
    return Texels(Skin(plane(60.0)), 0.3)


def test_shares_sum_to_one_in_each_channel() -> None:
    np.testing.assert_allclose(PROFILE.sum(axis=0), 1.0, atol=1e-12)


def test_an_edge_of_light_becomes_the_sum_of_error_functions(texels: Texels) -> None:
    """Half a plane in light, away from the plane's own edges."""
    x, y = texels.points.position[:, 0], texels.points.position[:, 1]
    entered = np.repeat((x > 0).astype(float)[:, None, None], 3, axis=2)
    arrived, kept = diffuse_inside(texels, entered, np.ones(len(x)))
    left = entered[:, 0] * kept + arrived[:, 0]
    # The edge lies between two rows of texels; a texel holds the mean over its width.
    inner = (np.abs(x) < 12) & (np.abs(y) < 12)
    inner &= np.abs(x) > 1e-6
    known = np.zeros((len(x), 3))
    for variance, share in zip(VARIANCES_MM2, PROFILE, strict=True):
        if variance**0.5 < FINEST * texels.spacing_mm:
            known += share * (x > 0)[:, None]
        else:
            known += share * (0.5 + 0.5 * erf(x / np.sqrt(2 * variance)))[:, None]
    assert np.abs(left - known)[inner].max() < 0.02
    assert np.sqrt(np.mean((left - known)[inner] ** 2, axis=0)).max() < 0.004


@pytest.mark.parametrize("shape", [plane, corner])
def test_energy_is_kept_and_uniform_light_unchanged(shape: Callable[..., Subject]) -> None:
    patches = Texels(Skin(shape(30.0)), 0.3)
    rng = np.random.default_rng(5)
    count = len(patches)
    entered = np.concatenate([np.ones((count, 1, 3)), rng.random((count, 1, 3))], axis=1)
    translucency = rng.random(count)
    arrived, kept = diffuse_inside(patches, entered, translucency)
    left = entered * kept[:, None] + arrived
    np.testing.assert_allclose(left[:, 0], 1.0, atol=1e-5)
    np.testing.assert_allclose(
        np.sum(left * patches.area[:, None, None], axis=0),
        np.sum(entered * patches.area[:, None, None], axis=0),
        rtol=1e-5,
    )
    assert kept.min() >= 0.0


def test_no_light_crosses_between_surfaces_that_face_away() -> None:
    """Skin of no translucency keeps its light where it fell."""
    patches = Texels(Skin(plane(20.0)), 0.3)
    entered = np.random.default_rng(6).random((len(patches), 1, 3))
    arrived, kept = diffuse_inside(patches, entered, np.zeros(len(patches)))
    assert not arrived.any()
    np.testing.assert_array_equal(kept, 1.0)


def test_wide_gaussians_are_summed_on_coarser_layers() -> None:
    assert layer_step(0.0064, 0.35) == 0
    assert layer_step(0.0484, 0.35) == 1
    assert layer_step(7.41, 0.35) == 4
