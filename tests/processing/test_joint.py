"""The joint solve of a pixel against plain float64, and on whatever a camera may give."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lighting.facets import BECKMANN, Facets
from processing.lighting.interface import Interface, skin_interface
from processing.lighting.lights import OCTAHEDRON, PatternLights, Shadows, cells_of
from processing.lighting.lobe import transport
from processing.lighting.polarisers import diffuse_of_normals, mirrored_of_lamps
from processing.refinement.joint import (
    Given,
    Noise,
    Place,
    Scattered,
    gloss_evidence,
    held_out,
    solve_jointly,
)
from processing.refinement.joint_kernels import Solved
from tests.processing import joint_twin, lit_ball
from tests.processing.joint_twin import Pixel
from tests.processing.lit_ball import PATTERNS, angle_deg

RIG = lit_ball.small_rig()
INTERFACE = skin_interface()
FAMILIES = tuple(
    skin_interface(facets)
    for facets in (
        BECKMANN,
        Facets(tails=True),
        Facets(stretch=1.4),
        Facets(True, 0.8),
        Facets(rises=False),
        Facets(True, covers=False),
    )
)
ALBEDO = np.array([0.55, 0.33, 0.22])
SEEDS = st.integers(0, 2**31)


LIGHTS = lit_ball.lights_of_rig(RIG)


@dataclasses.dataclass(frozen=True)
class Skin:
    """Pixels of skin, each a vertex of its own.

    Attributes: as of `Given`; truth holds the (n, 3) normals.
    """

    rgb: np.ndarray
    place: Place
    start: np.ndarray
    roughness: np.ndarray
    specular: np.ndarray
    around: Scattered
    truth: np.ndarray
    interface: Interface


def across(normals: np.ndarray, rng: np.random.Generator, degrees: float) -> np.ndarray:
    """Normals turned at random by about so much."""
    turned = normals + np.radians(degrees) * rng.normal(size=normals.shape)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def light_of(
    points: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray,
    shadows: Shadows,
    mirrored: np.ndarray,
    diffuse: np.ndarray,
    interface: Interface,
) -> tuple[np.ndarray, np.ndarray]:
    """E and B, of which only shares arrive."""
    e, b = transport(LIGHTS, points, normals, views, roughness, shadows, interface)
    if len(diffuse) == 1:
        return e, b
    e *= diffuse[cells_of(normals)]
    for i, share in enumerate(shares_at(points, mirrored)):
        seen = dataclasses.replace(LIGHTS, weight=LIGHTS.weight * share)
        one = [x[i : i + 1] for x in (points, normals, views, roughness)]
        b[i] = transport(seen, *one, shadows.of(np.array([i])), interface)[1][0]
    return e, b


def shares_at(points: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """(n, L) share of each lamp's mirror reflection that arrives from (n, 3) points."""
    return np.asarray((mirrored[0] + points @ mirrored[1:]) ** 2)


def unpolarised(lights: PatternLights) -> tuple[np.ndarray, np.ndarray]:
    """What of each lamp's reflection and of each normal's diffuse light reaches a camera: all."""
    camera = RIG.cameras[0]
    return mirrored_of_lamps(lights, camera), diffuse_of_normals(lights, camera)


def skin(
    seed: int,
    count: int = 12,
    *,
    noise: float = 0.001,
    off_deg: float = 2.0,
    lit: bool = True,
    polarised: bool = False,
    interface: Interface = INTERFACE,
) -> Skin:
    """Pixels of many normals, with or without light from other skin and from neighbours."""
    rng = np.random.default_rng(seed)
    normals = across(np.tile([[0.0, 0.0, 1.0]], (count, 1)), rng, 20)
    # Seen at 60 degrees at most, and so from the front.
    aside = across(normals, rng, 20)
    facing = np.einsum("nk,nk->n", aside, normals)[:, None] > 0.5
    views = np.where(facing, aside, normals)
    points = 95 * normals + rng.normal(size=normals.shape)
    roughness = rng.uniform(0.2, 0.34, count)
    specular = rng.uniform(0.015, 0.045, count)
    own = np.repeat(np.arange(count, dtype=np.int32)[:, None], 3, axis=1)
    alone = np.tile(np.array([[1, 0, 0]], np.float32), (count, 1))
    visible = np.ones((count, len(LIGHTS.position_mm)), np.uint8)
    shadows = Shadows(own, alone, visible)
    patterns = len(PATTERNS)
    bounced = rng.uniform(0, 0.05, (count, patterns, 3)) * lit
    kept = rng.uniform(0.7, 1.0, 3) if lit else np.ones(3)
    mirrored, reaching = unpolarised(LIGHTS)
    if polarised:
        mirrored = rng.uniform(-1, 1, mirrored.shape) * [[1], [0.004], [0.004], [0.004]]
        reaching = rng.uniform(0.4, 0.6, (OCTAHEDRON**2, patterns)).astype(np.float32)
    e, b = light_of(points, normals, views, roughness, shadows, mirrored, reaching, interface)
    rest = (1 - kept) * e[:, :, None] * rng.uniform(0.9, 1.1, (count, patterns, 3))
    inside = [
        joint_twin.entering(interface, np.array(float(n @ v)), m)
        for n, v, m in zip(normals, views, roughness, strict=True)
    ]
    passed = np.broadcast_to(reaching, (OCTAHEDRON**2, patterns))[cells_of(normals)]
    bounced_here = np.array(inside)[:, None, None] * passed[:, :, None] * bounced
    diffuse = kept * e[:, :, None] + rest + bounced_here
    rgb = ALBEDO * diffuse + (specular[:, None] * b)[:, :, None]
    rgb = rgb + noise * rng.normal(size=rgb.shape)
    return Skin(
        rgb.astype(np.float32),
        Place(points, views, shadows, bounced.astype(np.float32), mirrored, reaching),
        across(normals, rng, off_deg),
        roughness,
        specular,
        Scattered(kept, rest.astype(np.float32)),
        normals,
        interface,
    )


def given_by(s: Skin, noise: Noise) -> Given:
    """The pixels as `solve_jointly` takes them."""
    return Given(
        s.rgb, LIGHTS, s.place, s.start, s.roughness, s.specular, s.interface, s.around, noise
    )


def solved(s: Skin, noise: Noise, rounds: int = 1) -> Solved:
    return solve_jointly(given_by(s, noise), rounds)


def evidence(s: Skin, noise: Noise) -> np.ndarray:
    return gloss_evidence(given_by(s, noise))


def pixels(s: Skin) -> list[Pixel]:
    return [
        Pixel(
            s.rgb[i].astype(float),
            s.place.points_mm[i],
            s.place.views[i],
            s.start[i],
            float(s.roughness[i]),
            float(s.specular[i]),
            s.place.bounced[i].astype(float),
            s.around.kept,
            s.around.rest[i].astype(float),
            shares_at(s.place.points_mm[i], s.place.mirrored),
            s.place.diffuse,
        )
        for i in range(len(s.rgb))
    ]


@pytest.mark.parametrize("interface", FAMILIES, ids=lambda each: each.facets.name)
def test_the_twins_light_is_that_of_the_lobe(interface: Interface) -> None:
    s = skin(0, polarised=True, interface=interface)
    place = s.place
    e, b = light_of(
        place.points_mm, s.start, place.views, s.roughness, place.shadows,
        place.mirrored, place.diffuse, interface,
    )  # fmt: skip
    for i, pixel in enumerate(pixels(s)):
        light = joint_twin.Light(LIGHTS, pixel, interface, pixel.start)
        known_e, known_b = light.parts(pixel.start, pixel.roughness)
        np.testing.assert_allclose(e[i], known_e, atol=1e-5)
        np.testing.assert_allclose(b[i], known_b, rtol=1e-3, atol=1e-4)


@given(
    seed=SEEDS,
    lit=st.booleans(),
    shade=st.sampled_from([0.0, 0.01, 0.1]),
    polarised=st.booleans(),
    interface=st.sampled_from(FAMILIES),
)
@settings(max_examples=16, deadline=None)
def test_a_step_is_that_of_plain_float64(
    seed: int, lit: bool, shade: float, polarised: bool, interface: Interface
) -> None:
    s = skin(seed, lit=lit, polarised=polarised, interface=interface)
    noise = Noise(shade=shade)
    found = solved(s, noise)
    for i, pixel in enumerate(pixels(s)):
        known = joint_twin.step(LIGHTS, pixel, s.interface, noise)
        np.testing.assert_allclose(found.normal[i], known["normal"], atol=1e-4)
        albedo = found.lit[i] / found.power[i]
        np.testing.assert_allclose(albedo, known["albedo"], atol=1e-4)
        np.testing.assert_allclose(found.power[i], known["power"], rtol=1e-4)
        np.testing.assert_allclose(found.irradiance[i], known["irradiance"], atol=1e-4)
        np.testing.assert_allclose(found.misfit[i], known["misfit"], rtol=0.02, atol=0.02)
        np.testing.assert_allclose(found.certainty[i], known["certainty"], rtol=1e-3)


@given(seed=SEEDS, lit=st.booleans(), interface=st.sampled_from(FAMILIES))
@settings(max_examples=12, deadline=None)
def test_chromas_normal_and_its_noise_are_those_of_plain_float64(
    seed: int, lit: bool, interface: Interface
) -> None:
    s, noise = skin(seed, lit=lit, interface=interface), Noise()
    # Of one step, chroma's light is that of the start.
    found = solved(s, noise, rounds=1)
    for i, pixel in enumerate(pixels(s)):
        normal, turn2 = joint_twin.matte(LIGHTS, pixel, s.interface, noise)
        np.testing.assert_allclose(found.matte[i], normal, atol=2e-4)
        np.testing.assert_allclose(found.matte_turn2[i], turn2, rtol=2e-3)


def test_chromas_normal_errs_by_as_much_as_is_predicted() -> None:
    s = skin(4, 4000, noise=0, off_deg=0.3, lit=False)
    noise = Noise(sensor=0.01, model=0, shade=0)
    rng = np.random.default_rng(0)
    rgb = s.rgb + noise.sensor * np.sqrt(0.25 + s.rgb) * rng.normal(size=s.rgb.shape)
    clean = solved(s, noise, rounds=2)
    found = solved(dataclasses.replace(s, rgb=rgb.astype(np.float32)), noise, rounds=2)
    turned = np.radians(angle_deg(found.matte, clean.matte))
    assert 0.8 < np.mean(turned**2) / np.mean(found.matte_turn2) < 1.25


@given(
    seed=SEEDS,
    lit=st.booleans(),
    shade=st.sampled_from([0.0, 0.03]),
    polarised=st.booleans(),
    interface=st.sampled_from(FAMILIES),
)
@settings(max_examples=16, deadline=None)
def test_evidence_of_gloss_is_what_turns_and_albedos_cannot_explain(
    seed: int, lit: bool, shade: float, polarised: bool, interface: Interface
) -> None:
    s = skin(seed, off_deg=0.5, lit=lit, polarised=polarised, interface=interface)
    noise = Noise(shade=shade)
    found = evidence(s, noise)
    for i, pixel in enumerate(pixels(s)):
        known = joint_twin.evidence(LIGHTS, pixel, s.interface, noise)
        # An information of 1 is a standard deviation of 1, which tells nothing of a roughness:
        # pixels with less have rounding in it.
        one, other = np.sqrt(known[[0, 2]] + 1)
        scale = np.array([one**2, one * other, other**2])
        np.testing.assert_allclose(found[i, :3] / scale, known[:3] / scale, rtol=0, atol=2e-3)
        pulls = known[3:] / [one, other]
        np.testing.assert_allclose(found[i, 3:] / [one, other], pulls, rtol=5e-3, atol=0.02)


GROUPS = np.array([-1, 0, 0, 1, 1, 2, 2])


@given(
    seed=SEEDS,
    lit=st.booleans(),
    shade=st.sampled_from([0.0, 0.03]),
    interface=st.sampled_from(FAMILIES),
)
@settings(max_examples=12, deadline=None)
def test_what_is_left_out_is_predicted_from_a_fit_of_the_rest(
    seed: int, lit: bool, shade: float, interface: Interface
) -> None:
    s, noise = skin(seed, off_deg=0.5, lit=lit, interface=interface), Noise(shade=shade)
    found = held_out(given_by(s, noise), GROUPS)
    for i, pixel in enumerate(pixels(s)):
        known = joint_twin.held_out(LIGHTS, pixel, s.interface, noise, GROUPS)
        np.testing.assert_allclose(found[i], known, rtol=0.03, atol=0.03)


def test_readings_as_noisy_as_said_are_off_by_as_much_as_is_predicted() -> None:
    s, noise = skin(2, 4000, noise=0, off_deg=0.1), Noise(sensor=0.002, model=0, shade=0)
    sigma = noise.sensor * np.sqrt(noise.floor + s.rgb)
    rgb = s.rgb + sigma * np.random.default_rng(0).normal(size=s.rgb.shape)
    found = held_out(given_by(dataclasses.replace(s, rgb=rgb.astype(np.float32)), noise), GROUPS)
    np.testing.assert_allclose(np.nanmedian(found, axis=0), 0.85, atol=0.1)


def test_albedo_and_both_normals_of_clean_readings_are_exact() -> None:
    s = skin(1, 200, noise=0, off_deg=3)
    found = solved(s, Noise(), rounds=4)
    assert np.quantile(angle_deg(found.normal, s.truth), 0.95) < 0.05
    assert np.abs(found.lit / found.power - ALBEDO).max() < 2e-3
    calm = skin(1, 200, noise=0, off_deg=3, lit=False)
    found = solved(calm, Noise(), rounds=4)
    assert np.quantile(angle_deg(found.matte, calm.truth), 0.95) < 0.2


def test_misfit_of_readings_as_noisy_as_said_is_one() -> None:
    s = skin(2, 4000, noise=0, off_deg=0.3)
    noise = Noise(sensor=0.002, model=0, shade=0)
    rng = np.random.default_rng(0)
    sigma = noise.sensor * np.sqrt(0.25 + s.rgb)
    rgb = s.rgb + sigma * rng.normal(size=s.rgb.shape)
    found = solved(dataclasses.replace(s, rgb=rgb.astype(np.float32)), noise, rounds=2)
    # The albedos are found first, with equal weights.
    assert 0.95 < found.misfit.mean() < 1.15


@given(power=st.integers(-6, 6), seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_normals_do_not_depend_on_the_scale_of_readings_and_noise(power: int, seed: int) -> None:
    s, noise = skin(seed), Noise(sensor=0)
    scale = 10.0**power
    scaled = dataclasses.replace(
        s, rgb=(s.rgb.astype(float) * scale).astype(np.float32), specular=s.specular * scale
    )
    known, found = solved(s, noise), solved(scaled, noise)
    np.testing.assert_allclose(found.normal, known.normal, atol=1e-4)
    np.testing.assert_allclose(found.matte, known.matte, atol=1e-4)
    np.testing.assert_allclose(found.lit / scale, known.lit, rtol=1e-3, atol=1e-5)


BAD = st.floats(-1e6, 1e6) | st.sampled_from(
    [0.0, -0.0, 1e-12, 1e-6, 1e6, 1e12, np.nan, np.inf, -np.inf]
)


def check_sane(found: Solved, gloss: np.ndarray) -> None:
    for name, values in found._asdict().items():
        assert np.isfinite(values).all(), name
    for normals in (found.normal, found.matte):
        length = np.linalg.norm(normals, axis=1)
        assert ((length == 0) | (np.abs(length - 1) < 1e-5)).all()
    assert (found.power >= 0).all()
    assert (found.misfit >= 0).all()
    assert (found.certainty >= 0).all()
    assert (found.matte_turn2 >= 0).all()
    assert np.isfinite(gloss).all()
    assert (gloss[:, [0, 2]] >= 0).all()


def both(s: Skin) -> Solved:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, gloss = solved(s, Noise(), rounds=2), evidence(s, Noise())
        left_out = held_out(given_by(s, Noise()), GROUPS)
    assert not (left_out < 0).any()
    check_sane(found, gloss)
    return found


@given(
    readings=st.lists(BAD, min_size=21, max_size=21),
    roughness=st.sampled_from([0.0, 1e-6, 0.05, 0.28, 0.45, 5.0, np.nan]),
    specular=st.sampled_from([0.0, 0.03, 0.2, 1e6]),
    interface=st.sampled_from(FAMILIES),
)
@settings(max_examples=80, deadline=None)
def test_whatever_is_read_is_finite_or_zero(
    readings: list[float], roughness: float, specular: float, interface: Interface
) -> None:
    s = skin(0, 1, interface=interface)
    both(
        dataclasses.replace(
            s,
            rgb=np.array(readings, np.float32).reshape(1, 7, 3),
            roughness=np.array([roughness]),
            specular=np.array([specular]),
        )
    )


def test_a_residual_that_rounding_eats_is_not_negative() -> None:
    readings = np.zeros((1, 7, 3), np.float32)
    readings.flat[[1, 10, 11, 17, 20]] = 1, 544402, 1e12, 8, 1
    for interface in FAMILIES:
        s = skin(0, 1, interface=interface)
        bright = dataclasses.replace(
            s, rgb=readings, roughness=np.array([1e-6]), specular=np.array([0.0])
        )
        both(bright)


def test_pixels_that_hold_no_number_or_no_light_are_left_zero() -> None:
    s = skin(3, 4)
    rgb, start, roughness = s.rgb.copy(), s.start.copy(), s.roughness.copy()
    rgb[0, 2, 1] = np.nan
    start[1] = 0
    roughness[2] = 0
    bad = dataclasses.replace(s, rgb=rgb, start=start, roughness=roughness)
    found = both(bad)
    for name, values in found._asdict().items():
        assert not values[:3].any(), name
    good = solved(s, Noise(), rounds=2)
    np.testing.assert_array_equal(found.normal[3], good.normal[3])


@pytest.mark.parametrize("channel", range(3))
def test_a_dead_channel_has_no_albedo_and_disturbs_no_number(channel: int) -> None:
    s = skin(4)
    rgb = s.rgb.copy()
    rgb[:, :, channel] = 0
    found = both(dataclasses.replace(s, rgb=rgb))
    albedo = found.lit / np.maximum(found.power, 1e-9)
    assert (np.abs(albedo[:, channel]) < 0.1).all()


def test_in_full_shadow_nothing_is_solved() -> None:
    s = skin(5, lit=False)
    dark = dataclasses.replace(
        s.place, shadows=dataclasses.replace(s.place.shadows, visible=0 * s.place.shadows.visible)
    )
    found = both(dataclasses.replace(s, place=dark))
    assert not found.normal.any()


def test_pixels_seen_edge_on_and_from_behind_are_finite() -> None:
    s = skin(6, 64)
    angle = np.linspace(0, np.pi, 64)
    side = np.cross(s.start, [1.0, 0, 0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    views = np.cos(angle)[:, None] * s.start + np.sin(angle)[:, None] * side
    both(dataclasses.replace(s, place=dataclasses.replace(s.place, views=views)))
