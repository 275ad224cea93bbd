"""Burley's profile and the exchange of light between patches."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from sim.foreign.wandering import PATHS_MM, profile, scales_mm, wander, within
from sim.reference.points import Skin
from sim.reference.texels import Texels
from tests.sim.reference.surfaces import plane


@pytest.mark.parametrize("scale", [0.2, 1.0, 3.0])
def test_the_profile_sums_to_one_and_its_share_within_a_radius_is_its_integral(
    scale: float,
) -> None:
    for radius in (0.1, 1.0, 5.0, 400.0):
        found = quad(
            lambda r: 2 * np.pi * r * float(profile(np.array(r), scale)),
            1e-12,
            radius,
            points=sorted({min(scale, radius / 2), radius / 2}),
            limit=400,
        )[0]
        assert found == pytest.approx(float(within(np.array(radius), scale)), abs=1e-4)
    assert within(np.array(1e6), scale) == pytest.approx(1)


def test_red_goes_farther_than_blue_and_mean_free_paths_are_those_of_the_source() -> None:
    near = scales_mm(np.full(3, 0.33))
    np.testing.assert_allclose(near, np.array(PATHS_MM) / 3.5)
    assert (np.diff(near) < 0).all()


def test_what_a_patch_gets_and_keeps_of_even_light_is_all_of_it() -> None:
    texels = Texels(Skin(plane(size_mm=50.0)), 1.5)
    light = np.full((len(texels), 2, 3), 0.7, np.float32)
    arrived, kept = wander(texels, light, np.full(3, 0.5))
    np.testing.assert_allclose(arrived + kept[:, None] * light, 0.7, rtol=1e-5)
    assert (kept[:, 0] < kept[:, 1]).all()
    assert (kept[:, 1] < kept[:, 2]).all()


def test_a_spot_of_light_spreads_as_the_profile_says() -> None:
    texels = Texels(Skin(plane(size_mm=40.0)), 1.0)
    place = np.asarray(texels.points.position, float)
    middle = int(np.argmin(np.linalg.norm(place, axis=1)))
    light = np.zeros((len(texels), 1, 3), np.float32)
    light[middle] = 1.0
    arrived, _ = wander(texels, light, np.full(3, 0.5))
    far = np.linalg.norm(place - place[middle], axis=1)
    some = (far > 2.5) & (far < 6) & (np.abs(place[:, :2]) < 10).all(axis=1)
    known = profile(far[some], scales_mm(np.full(3, 0.5))[0]) * texels.area[middle]
    np.testing.assert_allclose(arrived[some, 0, 0], known, rtol=0.12)
