"""The light transport against closed forms and a plain float64 twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from scipy.special import erf

from lightstage.patterns import pattern_levels
from lightstage.rig import default_rig
from sim.lamps import light_weights
from sim.render import fresnel_dielectric, shade, smith_lambda


def twin(
    position, geometric, normal, view, albedo, specular, roughness, seen, lights, weights
):  # fmt: skip
    """Plain numpy float64: (s, n, 3) diffuse and specular; `seen` is (n, m) bool."""
    toward = lights[None] - position[:, None]
    distance = np.linalg.norm(toward, axis=-1)
    light = toward / distance[..., None]
    n_l = np.einsum("nk,nmk->nm", normal, light)
    above = seen & (n_l > 0) & (np.einsum("nk,nmk->nm", geometric, light) > 0)
    falloff = np.where(above, (np.linalg.norm(lights, axis=1) / distance) ** 2, 0.0)
    diffuse = np.einsum("smc,nm,nc->snc", weights, falloff * n_l, albedo)
    half = light + view[:, None]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    n_h = np.einsum("nk,nmk->nm", normal, half)
    n_v = np.maximum(np.einsum("nk,nk->n", normal, view), 1e-4)[:, None]
    m = roughness[:, None]
    tan2 = 1 / n_h**2 - 1
    d = np.where(n_h > 0, np.exp(-tan2 / m**2) / (np.pi * m**2 * n_h**4), 0.0)

    def masking(cosine):
        tangent = np.sqrt(np.maximum(1 / cosine**2 - 1, 1e-300))
        a = 1 / (m * tangent)
        rational = (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2)
        return np.where(a < 1.6, rational, 0.0)

    g = 1 / (1 + masking(np.where(above, n_l, 1.0)) + masking(n_v))
    f = snell(specular[:, None], np.einsum("nmk,nmk->nm", light, half))
    lobe = np.pi * d * f * g / (4 * n_v) * falloff
    return diffuse, np.einsum("smc,nm->snc", weights, lobe)[..., :3]


def snell(f0, cosine):
    """Unpolarised Fresnel reflectance by Snell's law, parallel and crossed amplitudes."""
    index = (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    crossed = (cosine - index * inside) / (cosine + index * inside)
    parallel = (index * cosine - inside) / (index * cosine + inside)
    return (crossed**2 + parallel**2) / 2


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def some_surface(rng, count=200, lights=40, states=3):
    """Random points near the origin that face the camera, with random visibility."""
    normal = unit(rng.normal(size=(count, 3)) + np.array([0, 0, 1.5]))
    position = 90 * unit(rng.normal(size=(count, 3)))
    geometric = unit(normal + 0.2 * rng.normal(size=(count, 3)))
    view = unit(np.array([0, 0, 1100.0]) - position)
    seen = rng.random((count, lights)) < 0.7
    places = 1250 * unit(rng.normal(size=(lights, 3)))
    weights = rng.random((states, lights, 3)) * (rng.random((states, lights, 1)) < 0.6)
    return (
        position,
        geometric,
        normal,
        view,
        rng.random((count, 3)),
        rng.uniform(0.01, 0.06, count),
        rng.uniform(0.15, 0.5, count),
        seen,
        places,
        weights,
    )


def call(surface):
    *parts, seen, lights, weights = surface
    bits = np.packbits(seen, axis=1, bitorder="little")
    return shade(*parts, bits, lights, weights)


def one_light(normal, light_mm, position=(0.0, 0.0, 0.0), f0=0.028, m=0.3):
    """Diffuse and specular reading of one white point under one light of weight 1."""
    view = unit(np.array([0, 0, 1100.0]) - np.array(position))
    surface = (
        np.array([position], float),
        np.array([normal], float),
        np.array([normal], float),
        view[None],
        np.ones((1, 3)),
        np.array([f0]),
        np.array([m]),
        np.ones((1, 1), bool),
        np.array([light_mm], float),
        np.ones((1, 1, 3)),
    )
    diffuse, specular = call(surface)
    return diffuse[0, 0, 0], specular[0, 0, 0]


def test_kernel_equals_its_float64_twin():
    surface = some_surface(np.random.default_rng(1))
    diffuse, specular = call(surface)
    known_diffuse, known_specular = twin(*surface)
    np.testing.assert_allclose(diffuse, known_diffuse, rtol=2e-5, atol=1e-5)
    np.testing.assert_allclose(specular, known_specular, rtol=2e-4, atol=2e-6)


def test_white_diffuser_at_the_origin_reads_one_under_full():
    rig = default_rig()
    weights = light_weights(rig)
    count = len(rig.lights)
    diffuse, _ = call(
        (
            np.zeros((1, 3)),
            np.array([[0, 0, 1.0]]),
            np.array([[0, 0, 1.0]]),
            np.array([[0, 0, 1.0]]),
            np.ones((1, 3)),
            np.zeros(1),
            np.full(1, 0.3),
            np.ones((1, count), bool),
            rig.positions_mm,
            weights[None],
        )
    )
    np.testing.assert_allclose(diffuse[0, 0], 1.0, rtol=1e-6)


def test_lambert_ball_in_uniform_light_reads_a_quarter_of_the_summed_weights():
    """The clamped cosine averages to 1/4 over the sphere, whatever the normal."""
    index = np.arange(4000) + 0.5
    polar, azimuth = np.arccos(1 - index / 2000), index * np.pi * (3 - np.sqrt(5))
    lights = 1e6 * np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    normal = unit(np.random.default_rng(2).normal(size=(50, 3)))
    surface = (
        80 * normal,
        normal,
        normal,
        normal,
        np.full((50, 3), 0.6),
        np.full(50, 0.028),
        np.full(50, 0.3),
        np.ones((50, 4000), bool),
        lights,
        np.full((1, 4000, 3), 1 / 4000),
    )
    diffuse, _ = call(surface)
    np.testing.assert_allclose(diffuse, 0.6 / 4, rtol=2e-3)


def test_light_falls_with_the_square_of_its_distance():
    """Weights are of the origin, so a point halfway to the light gets four times as much."""
    at_origin, _ = one_light([0, 0, 1], [0, 0, 1000])
    halfway, _ = one_light([0, 0, 1], [0, 0, 1000], position=(0, 0, 500))
    assert at_origin == pytest.approx(1.0, rel=1e-6)
    assert halfway == pytest.approx(4.0, rel=1e-5)


@pytest.mark.parametrize("angle_deg", [0, 30, 60, 85, 89.9])
def test_diffuse_light_falls_with_the_cosine(angle_deg):
    angle = np.deg2rad(angle_deg)
    found, _ = one_light([0, 0, 1], [1000 * np.sin(angle), 0, 1000 * np.cos(angle)])
    assert found == pytest.approx(np.cos(angle), abs=1e-6)


def test_light_below_either_horizon_gives_nothing():
    behind = one_light([0, 0, 1], [0, 500, -100])
    assert behind == (0.0, 0.0)
    surface = list(some_surface(np.random.default_rng(3), count=1, lights=1, states=1))
    surface[0], surface[2] = np.zeros((1, 3)), np.array([[0, 0, 1.0]])
    surface[1], surface[7] = np.array([[0, 0, -1.0]]), np.ones((1, 1), bool)
    surface[8], surface[9] = np.array([[0, 0, 1250.0]]), np.ones((1, 1, 3))
    assert np.all(np.array(call(tuple(surface))) == 0)


@pytest.mark.parametrize(
    ("angle_deg", "known"), [(0, 0.0278), (45, 0.037), (60, 0.072), (70, 0.150), (75, 0.231)]
)
def test_fresnel_is_that_of_a_dielectric_of_index_1_4(angle_deg, known):
    """Values after [BornWolf1999] for n = 1.4, not Schlick's."""
    cosine = np.cos(np.deg2rad(angle_deg))
    f0 = (0.4 / 2.4) ** 2
    found = fresnel_dielectric(f0, cosine)
    # The known values are printed to three digits.
    assert found == pytest.approx(known, rel=0.03)
    assert found == pytest.approx(float(snell(f0, cosine)), rel=1e-9)


def test_fresnel_covers_every_f0_and_angle():
    for f0 in np.linspace(0, 1, 21):
        for cosine in np.linspace(0, 1, 21):
            found = fresnel_dielectric(f0, cosine)
            assert -1e-12 <= found <= 1 + 1e-12
        assert fresnel_dielectric(f0, 1.0) == pytest.approx(min(f0, 0.999), abs=1e-9)


def test_masking_is_near_the_exact_integral_of_beckmann_slopes():
    for m in (0.2, 0.35, 0.5):
        for angle_deg in (20, 50, 70, 80, 88):
            cosine = np.cos(np.deg2rad(angle_deg))
            a = 1 / (m * np.tan(np.deg2rad(angle_deg)))
            exact = (erf(a) - 1) / 2 + np.exp(-a * a) / (2 * a * np.sqrt(np.pi))
            found, wanted = 1 / (1 + smith_lambda(cosine, m)), 1 / (1 + exact)
            assert found == pytest.approx(wanted, abs=4e-3)


def reflected_share(f0, m, cosine, count=20000):
    """What a surface seen at `cosine` mirrors of a uniform field of light 1."""
    index = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / count), index * np.pi * (3 - np.sqrt(5))
    lights = 1e6 * np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    view = np.array([[np.sqrt(1 - cosine**2), 0, cosine]])
    up = np.array([[0, 0, 1.0]])
    surface = (np.zeros((1, 3)), up, up, view, np.ones((1, 3)), np.array([f0]), np.array([m]))
    seen = np.ones((1, count), bool)
    _, specular = call((*surface, seen, lights, np.full((1, count, 3), 4 / count)))
    return specular[0, 0, 0]


@pytest.mark.parametrize("m", [0.2, 0.35, 0.5])
@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.3])
def test_a_mirror_of_facets_never_reflects_more_than_it_gets(m, cosine):
    """White furnace; what one bounce between facets loses is at most a seventh at m = .5."""
    share = reflected_share(1.0, m, cosine)
    assert 0.85 < share <= 1.0


@pytest.mark.parametrize("m", [0.2, 0.28, 0.35])
def test_specular_albedo_is_the_reflectance_at_normal_incidence(m):
    assert reflected_share(0.028, m, 1.0) == pytest.approx(0.028, rel=0.03)


@pytest.mark.parametrize("axis", "xyz")
def test_a_gradient_pair_sums_to_full(axis):
    rig = default_rig()
    names = ("full", f"{axis}+", f"{axis}-")
    levels = np.stack([pattern_levels(name, rig) for name in names])
    surface = list(some_surface(np.random.default_rng(4), lights=len(rig.lights)))
    surface[8], surface[9] = rig.positions_mm, levels[:, :, None] * light_weights(rig)
    diffuse, specular = call(tuple(surface))
    for part in (diffuse, specular):
        np.testing.assert_allclose(part[1] + part[2], part[0], atol=1e-5)


@settings(max_examples=60, deadline=None)
@given(
    npst.arrays(
        np.float64,
        (6, 3),
        elements=st.one_of(
            st.sampled_from([0.0, 1.0, -1.0, 1e-6, 1e6, np.nan, np.inf, -np.inf]),
            st.floats(-2, 2),
        ),
    ),
    st.integers(0, 6),
    st.sampled_from([0.0, 1e-6, 0.3, 1.0, 1e6]),
)
def test_broken_input_spoils_only_its_own_pixel(values, field, roughness):
    """A wrong pixel may read NaN or 0; its neighbours read as without it, and nothing is < 0."""
    surface = list(some_surface(np.random.default_rng(5), count=12, lights=5, states=1))
    clean = call(tuple(surface))
    surface[:7] = [np.array(part) for part in surface[:7]]
    broken = surface[field]
    broken[:6] = values if broken.ndim == 2 else values[:, 0]
    surface[6][:6] = roughness
    for part, known in zip(call(tuple(surface)), clean, strict=True):
        np.testing.assert_array_equal(part[:, 6:], known[:, 6:])
        if field in (0, 1, 2, 3) and np.isfinite(values).all():
            assert (np.isnan(part) | (part >= 0)).all()


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_the_unit_of_length_does_not_matter(scale):
    surface = list(some_surface(np.random.default_rng(6)))
    known = call(tuple(surface))
    surface[0], surface[8] = surface[0] * scale, surface[8] * scale
    for part, wanted in zip(call(tuple(surface)), known, strict=True):
        np.testing.assert_allclose(part, wanted, rtol=3e-4, atol=3e-6)


def test_a_light_at_the_point_itself_gives_nothing():
    found = one_light([0, 0, 1], [0, 0, 800], position=(0, 0, 800))
    assert found == (0.0, 0.0)


def test_grazing_views_stay_finite():
    normal = unit(np.array([1.0, 0, 1e-7]))
    diffuse, specular = one_light(normal, [1000, 0, 10], m=0.2)
    assert np.isfinite([diffuse, specular]).all()
    assert specular >= 0
