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
from sim.errors import SimError
from sim.light.facets import SKIN_F0, beckmann_lambda, fresnel_dielectric, ggx_lambda
from sim.light.lamps import LampConfig, Lamps, lamps_of, light_weights, point_lamps
from sim.light.olat import shade
from sim.light.render import ROUND, TILE, Lobe
from sim.light.transmittance import transmittance


def twin(
    position, geometric, normal, view, albedo, specular, roughness, seen, lamps, weights,
    lobe=ROUND,
):  # fmt: skip
    """Plain numpy float64: (s, n, 3) diffuse and specular; `seen` is (n, m) bool."""
    lights = lamps.positions_mm
    toward = lights[None] - position[:, None]
    distance = np.linalg.norm(toward, axis=-1)
    light = toward / distance[..., None]
    n_l = np.einsum("nk,nmk->nm", normal, light)
    above = seen & (n_l > 0) & (np.einsum("nk,nmk->nm", geometric, light) > 0)
    shine = np.maximum(np.einsum("mk,nmk->nm", lamps.axes, -light), 0) ** lamps.exponent
    falloff = np.where(above, shine * (np.linalg.norm(lights, axis=1) / distance) ** 2, 0.0)
    n_v = np.maximum(np.einsum("nk,nk->n", normal, view), 1e-4)[:, None]
    half = light + view[:, None]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    n_h = np.einsum("nk,nmk->nm", normal, half)
    m = roughness[:, None]
    m_u = m_v = m
    along = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    if lobe.tangent is not None:
        along = lobe.tangent
        m_u = m / np.sqrt(1 - 0.9 * lobe.anisotropy[:, None])
        m_v = m * np.sqrt(1 - 0.9 * lobe.anisotropy[:, None])
    along = unit(along - np.sum(along * normal, axis=1, keepdims=True) * normal)
    across = np.cross(normal, along)

    def local(vectors):
        return (vectors @ along[:, :, None])[..., 0], (vectors @ across[:, :, None])[..., 0]

    def slope(vectors, cosine):
        u, v = local(vectors)
        seen_m = np.sqrt(((m_u * u) ** 2 + (m_v * v) ** 2) / (u**2 + v**2))
        return seen_m * np.sqrt(1 - cosine**2)

    def through(slope, cosine):
        seen_m = slope / np.sqrt(np.maximum(1 - cosine**2, 1e-300))
        return transmittance(cosine, seen_m, lobe.distribution)[0]

    def masking(slope, cosine):
        tangent = np.maximum(slope / cosine, 1e-9)
        if lobe.distribution == "ggx":
            return (np.sqrt(1 + tangent**2) - 1) / 2
        a = 1 / tangent
        rational = (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2)
        return np.where(a < 1.6, rational, 0.0)

    u, v = local(half)
    tan2 = ((u / m_u) ** 2 + (v / m_v) ** 2) / n_h**2
    if lobe.distribution == "ggx":
        d = 1 / (np.pi * m**2 * n_h**4 * (1 + tan2) ** 2)
    else:
        d = np.exp(-tan2) / (np.pi * m**2 * n_h**4)
    d = np.where(n_h > 0, d, 0.0)
    cosine = np.where(above, n_l, 1.0)
    slope_l, slope_v = slope(light, cosine), slope(view[:, None], n_v)
    body = falloff * n_l * through(slope_l, cosine) * through(slope_v, n_v)
    body = body / transmittance(1.0, m, lobe.distribution)[1]
    diffuse = np.einsum("smc,nm,nc->snc", weights, body, albedo)
    g = 1 / (1 + masking(slope_l, cosine) + masking(slope_v, n_v))
    f = snell(SKIN_F0, np.einsum("nmk,nmk->nm", light, half)) * (specular / SKIN_F0)[:, None]
    mirror = np.pi * d * f * g / (4 * n_v) * falloff
    return diffuse, np.einsum("smc,nm->snc", weights, mirror)


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
        point_lamps(places),
        weights,
    )


def call(surface, lobe=ROUND):
    *parts, seen, lamps, weights = surface
    bits = np.packbits(seen, axis=1, bitorder="little")
    return shade(*parts, bits, lamps, weights, lobe)


def one_light(normal, light_mm, position=(0.0, 0.0, 0.0), f0=0.028, m=0.3, lamps=None):
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
        point_lamps(np.array([light_mm], float)) if lamps is None else lamps,
        np.ones((1, 1, 3)),
    )
    diffuse, specular = call(surface)
    return diffuse[0, 0, 0], specular[0, 0, 0]


def coating(cosine_in, cosine_out, m=0.3):
    """What the interface makes of a white Lambertian surface below it."""
    through, mean = transmittance(np.array([cosine_in, cosine_out]), m)
    return through[0] * through[1] / mean[0]


def some_lobe(rng, distribution, anisotropic, count=200):
    if not anisotropic:
        return Lobe(distribution)
    return Lobe(distribution, rng.normal(size=(count, 3)), rng.uniform(0, 0.9, count))


@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_kernel_equals_its_float64_twin(distribution, anisotropic):
    rng = np.random.default_rng(1)
    surface = list(some_surface(rng))
    surface[8] = lamps_of(default_rig(), LampConfig(exponent=2.5))
    surface[7] = rng.random((200, 168)) < 0.7
    surface[9] = rng.random((3, 168, 3)) * (rng.random((3, 168, 1)) < 0.6)
    lobe = some_lobe(rng, distribution, anisotropic)
    diffuse, specular = call(tuple(surface), lobe)
    known_diffuse, known_specular = twin(*surface, lobe)
    np.testing.assert_allclose(diffuse, known_diffuse, rtol=2e-5, atol=1e-5)
    np.testing.assert_allclose(specular, known_specular, rtol=2e-4, atol=1e-5)


def test_a_lobe_stretched_by_nothing_is_round():
    rng = np.random.default_rng(8)
    surface = some_surface(rng)
    stretched = Lobe("beckmann", rng.normal(size=(200, 3)), np.full(200, 1e-6))
    for part, known in zip(call(surface, stretched), call(surface), strict=True):
        np.testing.assert_allclose(part, known, rtol=1e-3, atol=1e-6)


def test_a_tangent_along_the_normal_leaves_the_lobe_round():
    surface = some_surface(np.random.default_rng(8))
    lost = Lobe("beckmann", surface[2].copy(), np.full(200, 0.9))
    for part, known in zip(call(surface, lost), call(surface), strict=True):
        np.testing.assert_allclose(part, known, rtol=1e-3, atol=1e-6)


def test_points_beyond_a_tile_are_shaded_as_those_within():
    surface = list(some_surface(np.random.default_rng(7), count=TILE + 700, lights=3, states=2))
    whole = call(tuple(surface))
    last = [np.asarray(part)[TILE + 600 :] for part in surface[:8]]
    for part, known in zip(call((*last, *surface[8:])), whole, strict=True):
        np.testing.assert_array_equal(part, known[:, TILE + 600 :])


def test_an_unknown_distribution_is_refused():
    with pytest.raises(SimError, match="phong"):
        Lobe("phong")


def test_white_skin_at_the_origin_reads_what_its_interface_lets_through():
    rig = default_rig()
    lamps = lamps_of(rig)
    count = len(rig.lights)
    up = np.array([[0, 0, 1.0]])
    surface = (np.zeros((1, 3)), up, up, up, np.ones((1, 3)), np.zeros(1), np.full(1, 0.3))
    diffuse, specular = call((*surface, np.ones((1, count), bool), lamps, lamps.weights[None]))
    cosine = np.maximum(unit(rig.positions_mm)[:, 2], 0)
    inward, mean = transmittance(cosine, 0.3)
    known = (lamps.weights[:, 0] * cosine * inward).sum() * transmittance(1.0, 0.3)[0] / mean[0]
    np.testing.assert_allclose(diffuse[0, 0], known, rtol=1e-5)
    # Without the interface it would read 1; the coat takes little and gives it back elsewhere.
    assert known == pytest.approx(1.0, abs=0.05)
    assert specular.max() == 0


def test_light_falls_with_the_square_of_its_distance():
    """Weights are of the origin, so a point halfway to the light gets four times as much."""
    at_origin, _ = one_light([0, 0, 1], [0, 0, 1000])
    halfway, _ = one_light([0, 0, 1], [0, 0, 1000], position=(0, 0, 500))
    assert at_origin == pytest.approx(coating(1.0, 1.0), rel=1e-5)
    assert halfway == pytest.approx(4.0 * at_origin, rel=1e-5)


@pytest.mark.parametrize("angle_deg", [0, 30, 60, 85, 89.9])
def test_diffuse_light_falls_with_the_cosine_and_what_is_let_in(angle_deg):
    angle = np.deg2rad(angle_deg)
    found, _ = one_light([0, 0, 1], [1000 * np.sin(angle), 0, 1000 * np.cos(angle)])
    assert found == pytest.approx(np.cos(angle) * coating(np.cos(angle), 1.0), abs=1e-6)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.5])
def test_a_lamp_shines_less_beside_its_axis(exponent):
    """The point lies 30 degrees off the axis of a lamp that looks at the origin."""
    place = np.array([[0, 0, 1000.0]])
    off = 1000 * np.tan(np.deg2rad(30))
    lamps = Lamps(place, np.ones((1, 3)), np.array([[0, 0, -1.0]]), exponent, 0.0)
    found, _ = one_light([0, 0, 1], place[0], position=(off, 0, 0), lamps=lamps)
    known, _ = one_light([0, 0, 1], place[0], position=(off, 0, 0))
    assert found == pytest.approx(known * np.cos(np.deg2rad(30)) ** exponent, rel=1e-5)


def test_nothing_shines_behind_a_lamp():
    place = np.array([[0, 0, 1000.0]])
    away = Lamps(place, np.ones((1, 3)), np.array([[0, 0, 1.0]]), 1.0, 0.0)
    assert one_light([0, 0, 1], place[0], lamps=away) == (0.0, 0.0)


def test_light_below_either_horizon_gives_nothing():
    behind = one_light([0, 0, 1], [0, 500, -100])
    assert behind == (0.0, 0.0)
    surface = list(some_surface(np.random.default_rng(3), count=1, lights=1, states=1))
    surface[0], surface[2] = np.zeros((1, 3)), np.array([[0, 0, 1.0]])
    surface[1], surface[7] = np.array([[0, 0, -1.0]]), np.ones((1, 1), bool)
    surface[8], surface[9] = point_lamps(np.array([[0, 0, 1250.0]])), np.ones((1, 1, 3))
    assert np.all(np.array(call(tuple(surface))) == 0)


def test_skipping_lamps_below_the_horizon_and_unlit_ones_changes_nothing():
    surface = list(some_surface(np.random.default_rng(9)))
    known = call(tuple(surface))
    toward = surface[8].positions_mm[None] - surface[0][:, None]
    surface[7] = surface[7] & (np.einsum("nk,nmk->nm", surface[1], toward) > 0)
    for part, wanted in zip(call(tuple(surface)), known, strict=True):
        np.testing.assert_array_equal(part, wanted)
    # A lamp that is lit in no state, but asked for, adds zeros.
    surface[9] = surface[9].copy()
    surface[9][:, ::3] = 0
    few = np.flatnonzero(np.arange(40) % 3)
    kept = [*surface[:7], surface[7][:, few], point_lamps(surface[8].positions_mm[few])]
    for part, wanted in zip(call(tuple(surface)), call((*kept, surface[9][:, few])), strict=True):
        np.testing.assert_allclose(part, wanted, rtol=1e-6)


@pytest.mark.parametrize(
    ("angle_deg", "known"), [(0, 0.0278), (45, 0.037), (60, 0.072), (70, 0.150), (75, 0.231)]
)
def test_fresnel_is_that_of_a_dielectric_of_index_1_4(angle_deg, known):
    """Values after [BornWolf1999] for n = 1.4, not Schlick's."""
    cosine = np.cos(np.deg2rad(angle_deg))
    found = fresnel_dielectric(1.4, cosine)
    # The known values are printed to three digits.
    assert found == pytest.approx(known, rel=0.03)
    assert found == pytest.approx(float(snell(SKIN_F0, cosine)), rel=1e-9)


def test_fresnel_covers_every_index_and_angle():
    for index in np.linspace(1, 50, 21):
        for cosine in np.linspace(0, 1, 21):
            if index > 1 or cosine > 0:
                assert -1e-12 <= fresnel_dielectric(index, cosine) <= 1 + 1e-12
        f0 = ((index - 1) / (index + 1)) ** 2
        assert fresnel_dielectric(index, 1.0) == pytest.approx(f0, abs=1e-9)


def test_masking_is_near_the_exact_integral_of_beckmann_slopes():
    for m in (0.2, 0.35, 0.5):
        for angle_deg in (20, 50, 70, 80, 88):
            angle = np.deg2rad(angle_deg)
            a = 1 / (m * np.tan(angle))
            exact = (erf(a) - 1) / 2 + np.exp(-a * a) / (2 * a * np.sqrt(np.pi))
            found = 1 / (1 + beckmann_lambda(np.cos(angle), m * np.sin(angle)))
            assert found == pytest.approx(1 / (1 + exact), abs=4e-3)


def test_masking_of_ggx_is_its_closed_form():
    for m in (0.05, 0.3, 0.8):
        for angle_deg in (0, 20, 60, 89):
            tangent = np.tan(np.deg2rad(angle_deg))
            cosine, sine = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
            known = 2 / (1 + np.sqrt(1 + m**2 * tangent**2))
            assert 1 / (1 + ggx_lambda(cosine, m * sine)) == pytest.approx(known, rel=1e-6)


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("prefix", ["", "lin-"])
def test_a_gradient_pair_sums_to_full(axis, prefix):
    rig = default_rig()
    names = ("full", f"{prefix}{axis}+", f"{prefix}{axis}-")
    levels = np.stack([pattern_levels(name, rig) for name in names])
    surface = list(some_surface(np.random.default_rng(4), lights=len(rig.lights)))
    surface[8], surface[9] = lamps_of(rig), levels[:, :, None] * light_weights(rig)
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
    st.integers(0, 8),
    st.sampled_from([0.0, 1e-6, 0.3, 1.0, 1e6, np.nan]),
    st.sampled_from(["beckmann", "ggx"]),
)
def test_broken_input_spoils_only_its_own_pixel(values, field, roughness, distribution):
    """A wrong pixel may read NaN or 0; its neighbours read as without it, and nothing is < 0."""
    rng = np.random.default_rng(5)
    surface = list(some_surface(rng, count=12, lights=5, states=1))
    lobe = some_lobe(rng, distribution, anisotropic=True, count=12)
    clean = call(tuple(surface), lobe)
    surface[:7] = [np.array(part) for part in surface[:7]]
    broken = (*surface[:7], lobe.tangent, lobe.anisotropy)[field]
    broken[:6] = values if broken.ndim == 2 else values[:, 0]
    surface[6][:6] = roughness
    for part, known in zip(call(tuple(surface), lobe), clean, strict=True):
        np.testing.assert_array_equal(part[:, 6:], known[:, 6:])
        if field in (0, 1, 2, 3, 7, 8) and np.isfinite(values).all():
            assert (np.isnan(part) | (part >= 0)).all()


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_the_unit_of_length_does_not_matter(scale):
    surface = list(some_surface(np.random.default_rng(6)))
    known = call(tuple(surface))
    surface[0] = surface[0] * scale
    surface[8] = point_lamps(surface[8].positions_mm * scale)
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
