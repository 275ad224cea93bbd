"""Solid angles: known shapes by formula, anything else against counted directions."""

import numpy as np
import pytest
from hypothesis import example, given, settings

from lightstage.patterns import drive_levels, light_weights
from lightstage.patterns.weights import directions, irradiance, solid_angles_sr, unevenness
from lightstage.rig import default_rig
from tests.lightstage.patterns.rigs import any_rig, rig_at

OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)]) * 1250.0


def counted(rig, samples=400_000, seed=3):
    """Share of random directions nearest to each light, in steradians."""
    rng = np.random.default_rng(seed)
    found = rng.normal(size=(samples, 3))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    toward = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    nearest = np.concatenate([(part @ toward.T).argmax(1) for part in np.array_split(found, 20)])
    return np.bincount(nearest, minlength=len(toward)) * 4 * np.pi / samples


def ring(angles_deg, height=0.0):
    angles = np.radians(angles_deg)
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(angles), 0 * angles + height, flat * np.sin(angles)], axis=1)


def test_an_octahedrons_lights_have_a_sixth_each():
    assert np.allclose(solid_angles_sr(rig_at(OCTAHEDRON)), 4 * np.pi / 6)
    assert np.allclose(light_weights(rig_at(OCTAHEDRON)), 1)


def test_the_default_rigs_rings_have_the_areas_of_their_zones():
    """Between rings of 12 lights 180/14 degrees apart the cells end halfway, nearly on circles."""
    found = solid_angles_sr(default_rig()).reshape(12, 14)
    edges = np.cos(np.pi * np.arange(15) / 14)
    zones = (edges[:-1] - edges[1:]) * 2 * np.pi / 12
    assert np.allclose(found.sum(), 4 * np.pi)
    assert np.allclose(found, found[0])
    assert np.allclose(found[0], found[0][::-1])
    # Great circles between neighbours bulge toward the poles, by 2.1 % of a zone at most.
    assert np.abs(found[0] / zones - 1).max() < 0.025


def test_areas_are_those_that_counting_finds():
    rng = np.random.default_rng(5)
    rig = rig_at(rng.normal(size=(23, 3)) * 1000)
    assert np.allclose(solid_angles_sr(rig), counted(rig), rtol=0.03)


@settings(max_examples=60)
@given(any_rig())
@example(rig_at([(0, 0, 1.0), (0, 0, -1.0), (0, 1.0, 0), (1.0, 2.2e-308, 0), (-1.0, 0, 0)]))
def test_any_rig_has_positive_areas_that_fill_the_sphere(rig):
    areas = solid_angles_sr(rig)
    assert np.isfinite(areas).all()
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(4 * np.pi, rel=1e-9)
    weights = light_weights(rig)
    assert ((weights > 0) & (weights <= 1)).all()
    assert weights.max() == 1


@settings(max_examples=15)
@given(any_rig())
def test_the_areas_of_any_rig_are_those_that_counting_finds(rig):
    """Lights nearly in one direction share what counting gives to one of them."""
    toward = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    group = (np.linalg.norm(toward[:, None] - toward, axis=2) < 1e-3).argmax(axis=1)
    found = np.bincount(group, solid_angles_sr(rig))
    known = np.bincount(group, counted(rig, 60_000))
    assert np.allclose(found, known, atol=0.12)


def test_one_light_has_the_sphere_and_two_half_each():
    assert solid_angles_sr(rig_at([(0, 0, 9.0)])) == pytest.approx([4 * np.pi])
    near = [(0, 0, 1000.0), (10.0, 0, 1000.0)]
    assert solid_angles_sr(rig_at(near)) == pytest.approx([2 * np.pi] * 2)


@pytest.mark.parametrize("height", [0.0, 0.3, -0.8])
def test_lights_on_a_circle_have_twice_the_angle_between_their_neighbours_middles(height):
    angles = np.array([0.0, 30, 90, 200, 350])
    known = np.radians([(30 + 10) / 2, (30 + 60) / 2, (60 + 110) / 2, (110 + 150) / 2, 80]) * 2
    assert np.allclose(solid_angles_sr(rig_at(ring(angles, height) * 900)), known)


def test_lights_in_one_direction_share_its_area():
    near = OCTAHEDRON[0] + np.array([0, 1e-3, 0])
    doubled = np.concatenate([OCTAHEDRON, OCTAHEDRON[:1], near[None]])
    areas = solid_angles_sr(rig_at(doubled))
    assert np.allclose(areas[[0, 6, 7]], 4 * np.pi / 18)
    assert np.allclose(areas[1:6], 4 * np.pi / 6)


def test_a_thousand_lights_in_one_direction_share_it_too():
    areas = solid_angles_sr(rig_at(np.repeat([[0, 0, 1000.0]], 1000, axis=0)))
    assert np.allclose(areas, 4 * np.pi / 1000)


def test_a_domes_rim_stands_for_the_directions_below_it():
    up = directions(200)
    up = up[up[:, 1] > 0.05]
    rig = rig_at(up * 1000)
    areas = solid_angles_sr(rig)
    assert np.allclose(areas, counted(rig), rtol=0.08)
    rim = up[:, 1] < 0.15
    assert areas[rim].mean() > 3 * areas[~rim].mean()


def test_a_crowd_too_small_to_have_a_hull_still_has_areas():
    rng = np.random.default_rng(2)
    crowd = np.array([0, 0, 1.0]) + 1e-4 * rng.normal(size=(12, 3))
    areas = solid_angles_sr(rig_at(crowd * 1000))
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(4 * np.pi)


def test_a_light_twice_as_far_is_driven_four_times_as_strongly():
    places = OCTAHEDRON.copy()
    places[2] *= 2
    assert np.allclose(light_weights(rig_at(places)), [0.25, 0.25, 1, 0.25, 0.25, 0.25])


def test_ten_thousand_lights_have_their_areas():
    rng = np.random.default_rng(0)
    areas = solid_angles_sr(rig_at(rng.normal(size=(10_000, 3))))
    assert areas.sum() == pytest.approx(4 * np.pi)
    assert (areas > 0).all()


def test_full_is_even_by_solid_angle_and_not_by_on_and_off():
    """On a white sphere at the centre of the default rig; figures of the read me."""
    rig = default_rig()
    normals = directions(4000)
    even = irradiance(rig, drive_levels("full", rig), normals)
    plain = irradiance(rig, drive_levels("full", rig, "on-off"), normals)
    assert np.ptp(even) / even.mean() < 0.04
    assert np.ptp(plain) / plain.mean() > 0.45
    assert unevenness(rig, drive_levels("full", rig)) < 0.006
    assert unevenness(rig, drive_levels("full", rig, "on-off")) > 0.13
    assert unevenness(rig, np.zeros(168)) == 0


@given(any_rig())
@settings(max_examples=20)
def test_irradiance_is_the_plain_sum(rig):
    normals = directions(7)
    levels = np.linspace(0, 1, len(rig.lights))
    middle = np.median(np.linalg.norm(rig.positions_mm, axis=1))
    for normal, found in zip(normals, irradiance(rig, levels, normals), strict=True):
        known = 0.0
        for place, level in zip(rig.positions_mm, levels, strict=True):
            far = np.linalg.norm(place)
            known += level * (middle / far) ** 2 * max(0.0, float(normal @ place / far))
        assert found == pytest.approx(known, abs=1e-9)
