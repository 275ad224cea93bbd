"""Factors of polarised light: against plain operators, against Mitsuba's Mueller matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.light.polarised_factors import fresnel_amplitudes, polarised_factors

INDEX = 1.4


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def across(axis: np.ndarray, ray: np.ndarray) -> np.ndarray:
    return unit(axis - (axis @ ray) * ray)


def plain(
    normal: np.ndarray,
    view: np.ndarray,
    light: np.ndarray,
    lamp: np.ndarray,
    lens: np.ndarray,
    lamp_extinction: float = np.inf,
    lens_extinction: float = np.inf,
) -> tuple[float, float]:
    """The same factors by 3 x 3 operators on the field, in float64."""
    half = unit(light + view)
    s = unit(np.cross(light, view))
    cosine = light @ half
    inside = np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    r_s = (cosine - INDEX * inside) / (cosine + INDEX * inside)
    r_p = (INDEX * cosine - inside) / (INDEX * cosine + inside)
    mirror = r_s * np.outer(s, s) + r_p * np.outer(np.cross(view, s), np.cross(-light, s))
    e, a = across(lamp, light), across(lens, view)
    shines = np.array([1.0, 1 / lamp_extinction]) / (1 + 1 / lamp_extinction)
    fields = (e, np.cross(light, e))
    passes = (a, np.cross(view, a))
    shares = (1.0, 1 / lens_extinction)
    specular = sum(
        w * k * (y @ mirror @ u) ** 2
        for w, u in zip(shines, fields, strict=True)
        for k, y in zip(shares, passes, strict=True)
    ) / (0.5 * (r_s**2 + r_p**2))

    def enters(ray: np.ndarray) -> np.ndarray:
        """(3, 3) transmittance of energy across a ray, times 2 over that of unpolarised light."""
        c = normal @ ray
        t = np.sqrt(1 - (1 - c**2) / INDEX**2)
        t_s = 1 - ((c - INDEX * t) / (c + INDEX * t)) ** 2
        t_p = 1 - ((INDEX * c - t) / (INDEX * c + t)) ** 2
        upright = unit(np.cross(normal, ray))
        flat = np.cross(ray, upright)
        both = t_s * np.outer(upright, upright) + t_p * np.outer(flat, flat)
        return both / (0.5 * (t_s + t_p))

    inward = sum(w * (u @ enters(light) @ u) for w, u in zip(shines, fields, strict=True))
    outward = sum(k * (y @ enters(view) @ y) for k, y in zip(shares, passes, strict=True)) / 2
    return float(inward * outward), float(specular)


def factors(
    normal: np.ndarray,
    view: np.ndarray,
    light: np.ndarray,
    lamp: np.ndarray,
    lens: np.ndarray,
    lamp_extinction: float = np.inf,
    lens_extinction: float = np.inf,
) -> tuple[float, float]:
    diffuse, specular = polarised_factors(
        np.zeros((1, 3)),
        normal[None],
        view[None],
        1250 * light[None],
        lamp[None],
        lens,
        INDEX,
        lamp_extinction,
        lens_extinction,
    )
    return float(diffuse[0, 0]), float(specular[0, 0])


def random_place(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    light, view = rng.normal(size=3), rng.normal(size=3)
    light[2], view[2] = abs(light[2]) + 0.05, abs(view[2]) + 0.05
    return (
        np.array([0.0, 0.0, 1.0]),
        unit(view),
        unit(light),
        unit(rng.normal(size=3)),
        unit(rng.normal(size=3)),
    )


def test_factors_are_those_of_plain_operators() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        place = random_place(rng)
        extinctions = tuple(10.0 ** rng.uniform(0, 5, size=2))
        np.testing.assert_allclose(factors(*place), plain(*place), atol=2e-5)
        np.testing.assert_allclose(
            factors(*place, *extinctions), plain(*place, *extinctions), atol=2e-5
        )


def test_unpolarised_lamps_and_lenses_change_nothing() -> None:
    """Extinction 1 of lamp and lens: the lens passes both fields whole, all factors are 1."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        np.testing.assert_allclose(factors(*random_place(rng), 1.0, 1.0), (1.0, 1.0), atol=1e-5)


def test_crossed_and_parallel_lenses_share_all_light() -> None:
    """Two lenses at right angles together see what one without a polariser does."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        normal, view, light, lamp, lens = random_place(rng)
        other = np.cross(view, across(lens, view))
        one = np.array(factors(normal, view, light, lamp, lens))
        two = np.array(factors(normal, view, light, lamp, other))
        np.testing.assert_allclose(
            one + two, factors(normal, view, light, lamp, lens, lens_extinction=1.0), atol=1e-5
        )


def test_light_and_view_may_change_places() -> None:
    """Helmholtz: the field that the lens passes, sent back, finds the lamp as strongly."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        normal, view, light, lamp, lens = random_place(rng)
        there = factors(normal, view, light, lamp, lens)
        back = factors(normal, light, view, lens, lamp)
        np.testing.assert_allclose(there, back, atol=1e-5)


def test_straight_back_a_crossed_lens_sees_nothing_of_the_mirror() -> None:
    up = np.array([0.0, 0.0, 1.0])
    for angle in np.radians([0, 20, 45, 90]):
        lamp = np.array([np.cos(angle), np.sin(angle), 0.0])
        cross = factors(up, up, up, lamp, np.cross(up, lamp))
        parallel = factors(up, up, up, lamp, lamp)
        np.testing.assert_allclose(cross, (0.5, 0.0), atol=1e-6)
        np.testing.assert_allclose(parallel, (0.5, 1.0), atol=1e-6)


@pytest.mark.parametrize("extinction", [10.0, 1000.0])
def test_the_leak_straight_back_is_that_of_both_polarisers(extinction: float) -> None:
    up, x, y = np.eye(3)[2], np.eye(3)[0], np.eye(3)[1]
    _, leak = factors(up, up, up, x, y, extinction, extinction)
    assert leak == pytest.approx(2 / extinction * (extinction / (1 + extinction)), rel=1e-4)


def test_at_brewsters_angle_the_field_in_the_plane_is_not_mirrored() -> None:
    angle = np.arctan(INDEX)
    view = np.array([np.sin(angle), 0.0, np.cos(angle)])
    light = view * [-1, 1, 1]
    lens = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    _, inside = factors(np.eye(3)[2], view, light, np.eye(3)[0], lens)
    _, outside = factors(np.eye(3)[2], view, light, np.eye(3)[1], np.eye(3)[1])
    assert inside < 1e-6
    assert outside == pytest.approx(2.0, abs=1e-5)


def test_amplitudes_square_to_fresnels_reflectances() -> None:
    """At n = 1.4: .0278 straight on, .037 at 45 degrees, .072 at 60, .231 at 75."""
    for degrees, known in ((0, 0.0278), (45, 0.0366), (60, 0.0717), (75, 0.2314)):
        r_s, r_p = fresnel_amplitudes(INDEX, np.cos(np.radians(degrees)))
        assert 0.5 * (r_s**2 + r_p**2) == pytest.approx(known, abs=5e-4)


SIZES = st.sampled_from([0.0, 1e-6, 1.0, -1.0, 1e6, -1e6])


@settings(max_examples=200, deadline=None)
@given(
    lamp_place=st.tuples(SIZES, SIZES, SIZES),
    lamp=st.tuples(SIZES, SIZES, SIZES),
    lens=st.tuples(SIZES, SIZES, SIZES),
    view=st.sampled_from([(0, 0, 1), (1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 0)]),
    normal=st.sampled_from([(0, 0, 1), (1, 0, 0), (0, 0, 0)]),
)
def test_degenerate_places_give_finite_factors(
    lamp_place: tuple, lamp: tuple, lens: tuple, view: tuple, normal: tuple
) -> None:
    diffuse, specular = polarised_factors(
        np.zeros((1, 3)),
        np.array([normal], float),
        np.array([view], float),
        np.array([lamp_place]),
        np.array([lamp]),
        np.array(lens),
        INDEX,
        1000.0,
        1000.0,
    )
    for found in (diffuse, specular):
        assert np.isfinite(found).all()
        assert (found >= 0).all()
        assert (found <= 2.01).all()


def stokes(axis: np.ndarray, travels: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """(4,) of light polarised along an axis, in Mitsuba's basis across its direction of travel."""
    x, y = axis @ basis, axis @ np.cross(travels, basis)
    return np.array([1.0, x * x - y * y, 2 * x * y, 0.0])


@pytest.mark.parametrize("part", ["diffuse", "specular"])
def test_factors_are_those_of_mitsubas_mueller_matrices(part: str) -> None:
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    mi.set_variant("scalar_spectral_polarized")
    skin = mi.load_dict(
        {
            "type": "pplastic",
            "diffuse_reflectance": {"type": "spectrum", "value": 0.5 * (part == "diffuse")},
            "specular_reflectance": {"type": "spectrum", "value": 1.0 * (part == "specular")},
            "int_ior": INDEX,
            "ext_ior": 1.0,
            "alpha": 0.3,
        }
    )
    rng = np.random.default_rng(5)
    brightest = 0.0
    for _ in range(200):
        normal, view, light, lamp, lens = random_place(rng)
        place = mi.SurfaceInteraction3f()
        place.wi = mi.Vector3f(*view)
        place.wavelengths = [500.0] * 4
        matrix = np.array(skin.eval(mi.BSDFContext(), place, mi.Vector3f(*light), True))
        matrix = matrix.reshape(4, 4, -1)[:, :, 0]
        base_in = np.array(mi.mueller.stokes_basis(mi.Vector3f(*(-light))))
        base_out = np.array(mi.mueller.stokes_basis(mi.Vector3f(*view)))
        arrives = stokes(across(lamp, light), -light, base_in)
        known = 0.5 * stokes(across(lens, view), view, base_out) @ matrix @ arrives
        found = matrix[0, 0] * factors(normal, view, light, lamp, lens)[part == "specular"]
        assert found == pytest.approx(known, abs=1e-5)
        brightest = max(brightest, known)
    assert brightest > 0.05
