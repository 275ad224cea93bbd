"""Energy and reciprocity of the skin's reflectance: what comes in goes out, either way round."""

from __future__ import annotations

import numpy as np
import pytest

from sim.light.facets import SKIN_F0
from sim.light.lamps import point_lamps
from sim.light.olat import shade
from sim.light.render import Lobe
from sim.light.transmittance import transmittance, transmittance_table

ANGLES_DEG = (0, 20, 40, 60, 70, 80, 85)
UP = np.array([0.0, 0.0, 1.0])


def sphere(count):
    """Evenly spread directions."""
    index = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / count), index * np.pi * (3 - np.sqrt(5))
    return np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )


def reflected(views, m, lobe, lights, weights, specular=SKIN_F0):
    """(n, 2) diffuse and specular light of a white surface that faces +z, one point per view."""
    count = len(views)
    normal = np.tile(UP, (count, 1))
    diffuse, mirror = shade(
        np.zeros((count, 3)),
        normal,
        normal,
        views,
        np.ones((count, 3)),
        np.full(count, specular),
        np.broadcast_to(m, count),
        np.full((count, (len(lights) + 7) // 8), 255, np.uint8),
        point_lamps(1e6 * lights),
        np.broadcast_to(np.asarray(weights)[None, :, None], (1, len(lights), 3)),
        lobe,
    )
    return np.stack([diffuse[0, :, 0], mirror[0, :, 0]], axis=1)


def tilted(angles_deg, azimuth_deg=0.0):
    angle, azimuth = np.deg2rad(angles_deg), np.deg2rad(azimuth_deg)
    x, y = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)
    return np.stack([x, y, np.cos(angle)], axis=1)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("m", [0.1, 0.2, 0.35, 0.5])
def test_white_skin_in_a_white_furnace_leaves_all_it_gets(m, distribution):
    """Irradiance 1 from everywhere, radiance within 0.5 % at all angles."""
    lights = sphere(100_000)
    found = reflected(tilted(ANGLES_DEG), m, Lobe(distribution), lights, np.full(100_000, 4e-5))
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=5e-3)


def test_stretched_lobes_keep_energy_on_average_over_the_azimuth():
    """One direction alone may be off by some per cent: its own m stands for a stretched lobe's."""
    lights, angles = sphere(20_000), np.repeat((20, 60, 75), 8)
    views = tilted(angles, np.tile(np.arange(8) * 45.0, 3))
    tangent = np.tile([1.0, 0.0, 0.0], (24, 1))
    lobe = Lobe("beckmann", tangent, np.full(24, 0.6))
    found = reflected(views, 0.3, lobe, lights, np.full(20_000, 2e-4)).sum(axis=1)
    np.testing.assert_allclose(found, 1.0, atol=0.02)
    np.testing.assert_allclose(found.reshape(3, 8).mean(axis=1), 1.0, atol=0.01)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_diffuse_albedo_is_what_leaves_of_what_entered(distribution):
    """The mean over the hemisphere, weighted by the cosine, of light that came from 60 degrees."""
    views = sphere(40_000)
    views = views[views[:, 2] > 0]
    light = tilted(np.array([60.0]))
    found = reflected(views, 0.3, Lobe(distribution), light, [1.0])[:, 0]
    left = (found * views[:, 2]).sum() / views[:, 2].sum()
    entered = 0.5 * transmittance(0.5, 0.3, distribution)[0]
    assert left == pytest.approx(float(entered), rel=1e-3)


@pytest.mark.parametrize("stretched", [False, True])
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_light_and_camera_may_change_places(distribution, stretched):
    """Helmholtz reciprocity, of both parts, for any normal, roughness and tangent."""
    rng = np.random.default_rng(1)
    count = 400
    normal = rng.normal(size=(count, 3)) + 1.5 * UP
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    m = rng.uniform(0.1, 0.6, count)
    lobe = Lobe(distribution)
    if stretched:
        lobe = Lobe(distribution, rng.normal(size=(count, 3)), rng.uniform(0, 0.9, count))
    one, two = tilted(np.array([25.0, 50.0]), np.array([10.0, 200.0]))
    both = (normal @ one > 0.05) & (normal @ two > 0.05)
    found = []
    for view, light in ((one, two), (two, one)):
        parts = shade(
            np.zeros((count, 3)),
            normal,
            normal,
            np.tile(view, (count, 1)),
            np.ones((count, 3)),
            np.full(count, SKIN_F0),
            m,
            np.ones((count, 1), np.uint8),
            point_lamps(1e6 * light[None]),
            np.ones((1, 1, 3)),
            lobe,
        )
        found.append([part[0, both, 0] / (normal[both] @ light) for part in parts])
    assert both.sum() > 200
    for here, there in zip(*found, strict=True):
        assert here.max() > 0.01
        np.testing.assert_allclose(here, there, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize("m", [0.2, 0.28, 0.35])
def test_specular_albedo_is_the_reflectance_at_normal_incidence(m):
    lights = sphere(20_000)
    found = reflected(UP[None], m, Lobe(), lights, np.full(20_000, 2e-4), specular=0.04)
    assert found[0, 1] == pytest.approx(0.04, rel=0.03)


def test_specular_light_is_in_proportion_to_the_map():
    lights = sphere(500)
    thin, thick = (
        reflected(tilted(ANGLES_DEG), 0.3, Lobe(), lights, np.ones(500), specular=s)
        for s in (0.02, 0.04)
    )
    np.testing.assert_allclose(thick[:, 1], 2 * thin[:, 1], rtol=1e-6)
    np.testing.assert_array_equal(thick[:, 0], thin[:, 0])


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("m", [0.1, 0.3, 0.5, 0.9])
def test_transmittance_is_a_plain_sum_over_directions_of_light(m, distribution):
    """Our table integrates over facets; here the lobe is summed over evenly spread lights."""
    lights = sphere(200_000)
    lights = lights[lights[:, 2] > 0].astype(float)
    for cosine in (1.0, 0.7, 0.4, 0.1):
        view = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
        half = lights + view
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        tan2 = (1 / half[:, 2] ** 2 - 1) / m**2
        wide = 1 / (1 + tan2) ** 2 if distribution == "ggx" else np.exp(-tan2)
        density = wide / (np.pi * m**2 * half[:, 2] ** 4)
        c = half @ view
        g = np.sqrt(1.4**2 - 1 + c**2)
        fresnel = ((g - c) / (g + c)) ** 2 / 2
        fresnel *= 1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2

        def smith(z):
            tangent = m * np.sqrt(1 / np.minimum(z, 1 - 1e-12) ** 2 - 1)
            if distribution == "ggx":
                return (np.sqrt(1 + tangent**2) - 1) / 2
            a = 1 / tangent
            fit = (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2)
            return np.where(a < 1.6, fit, 0.0)

        masking = 1 / (1 + smith(lights[:, 2]) + smith(np.array([cosine])))
        share = (density * fresnel * masking / (4 * cosine)).sum() * 4 * np.pi / 200_000
        found = transmittance(cosine, m, distribution)[0]
        assert 1 - found == pytest.approx(share, abs=2e-3)


def test_transmittance_of_a_smooth_surface_is_fresnels():
    """Mean transmittance of n = 1.4 by quadrature of the exact formula."""
    for cosine, reflectance in ((1.0, 0.0278), (0.5, 0.0720)):
        found = transmittance(cosine, 0.0)[0]
        assert 1 - found == pytest.approx(reflectance, abs=3e-4)
    assert transmittance(1.0, 0.0)[1] == pytest.approx(0.9232, abs=2e-4)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_transmittance_is_a_share_and_grows_with_the_cosine(distribution):
    table, mean = transmittance_table(distribution)
    assert (table > 0).all()
    assert (table < 1).all()
    # Rows from m = .016; so little as the first ones have is a mirror to any camera.
    assert (np.diff(table, axis=1)[4:] > -2e-5).all()
    assert (mean > table.min(axis=1)).all()
    assert (mean < table.max(axis=1)).all()


@pytest.mark.parametrize("value", [-1.0, 2.0, 1e6, 1e-6])
def test_transmittance_outside_the_table_is_that_of_its_border(value):
    edge = transmittance(np.clip(value, 0, 1), np.clip(value, 0, 1))
    np.testing.assert_allclose(transmittance(value, value), edge)
