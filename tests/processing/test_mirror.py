"""Specular normals from mirror directions, polarisers at facets, and trust, each to its twin."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.patterns import SEQUENCES
from lightstage.rig import default_rig
from processing.lighting.lights import PatternLights, cells_of, far_field, no_shadows
from processing.lighting.lobe import transport
from processing.lighting.polarisers import (
    diffuse_shares,
    mirror_amplitudes,
    mirror_lights,
    mirrored_of_lamps,
)
from processing.normals import solve_far_normals
from processing.separation.config import MirrorConfig
from processing.separation.lobe_fit import with_detail
from processing.separation.lobe_table import LobeTable, lobe_table, table_lobe
from processing.separation.mirror import mirror_normals
from processing.separation.trust import normal_trust
from sim.light.polarised import PolariserConfig, facet_shares, lamp_axes, lens_axis
from sim.light.polarised_factors import polarised_factors
from tests.processing import lit_ball, shots
from tests.processing.lit_ball import Ball, angle_deg

RIG = lit_ball.small_rig(factor=0.015)
SIGHT = shots.middle(lit_ball.see(Ball(), RIG.cameras[0]))
INNER = (SIGHT.normals * SIGHT.views).sum(axis=1) > 0.4
BINARY = shots.rig_lights(RIG, SEQUENCES["binary"])
LINEAR = shots.rig_lights(RIG, SEQUENCES["linear"])
WIDTHS = (0.18, 0.22, 0.26, 0.30, 0.34)
FRONT = SIGHT.views.mean(axis=0)
LIT = {"b": BINARY, "l": LINEAR}
WIDE = MirrorConfig(spread_deg=30.0)


@functools.cache
def table(name: str) -> LobeTable:
    """The lobe under the lights `LIT[name]`, from the front."""
    return lobe_table(LIT[name], FRONT, WIDTHS)


def bent(degrees: float) -> np.ndarray:
    """(n, 3) the ball's normals, each turned by so much some way."""
    rng = np.random.default_rng(3)
    aside = np.cross(SIGHT.normals, rng.normal(size=SIGHT.normals.shape))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    turn = math.radians(degrees)
    return SIGHT.normals * math.cos(turn) + aside * math.sin(turn)


def seen(lights: PatternLights, normals: np.ndarray, roughness: float) -> np.ndarray:
    """(n, P) the mirror reflection of facets of specular albedo .03."""
    sky = no_shadows(len(normals), lights)
    return 0.03 * transport(lights, SIGHT.points_mm, normals, SIGHT.views, roughness, sky)[1]


def found(
    name: str, lights: PatternLights, roughness: float, noise: float, config: MirrorConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles of the start and of the specular normals to the truth, and sigma, degrees."""
    truth = bent(6.0)
    reading = seen(lights, truth, roughness)
    reading = reading + np.random.default_rng(0).normal(0, 1, reading.shape) * noise
    sigma = np.full(reading.shape, max(noise, 1e-6))
    result = mirror_normals(
        reading, sigma, table(name), SIGHT.points_mm, SIGHT.normals, SIGHT.views, roughness, config
    )
    start = angle_deg(SIGHT.normals, truth)[INNER]
    return start, angle_deg(result.normal, truth)[INNER], np.degrees(result.sigma_rad)[INNER]


def test_the_table_is_the_lobe() -> None:
    sky = no_shadows(len(SIGHT.normals), BINARY)
    points = (SIGHT.points_mm, SIGHT.normals, SIGHT.views)
    for m in (0.2, 0.26):
        known = transport(BINARY, *points, m, sky)[1]
        off = np.abs(table_lobe(table("b"), *points, m) - known)
        steep = (SIGHT.normals * SIGHT.views).sum(axis=1) > 0.7
        assert off[steep].mean() < 0.02 * known[steep].mean()
        assert off[INNER].mean() < 0.03 * known[INNER].mean()


@pytest.mark.parametrize("m", [0.2, 0.3])
def test_a_pixel_far_from_the_centre_has_the_lobe_of_its_own_place(m: float) -> None:
    """Its parallax to the lamps is 5 degrees, and its view is as far from the table's."""
    points, normals = 100 * SIGHT.normals, SIGHT.normals
    views = RIG.cameras[0].centre_mm - points
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    facing = (normals * views).sum(axis=1)
    known = transport(BINARY, points, normals, views, m, no_shadows(len(points), BINARY))[1]
    found = table_lobe(table("b"), points, normals, views, m)
    for low, high, bias, error in (
        (0.4, 0.6, 0.08, 0.1),
        (0.6, 0.8, 0.03, 0.07),
        (0.8, 1, 0.01, 0.04),
    ):
        here = (facing >= low) & (facing < high)
        assert found[here].sum() == pytest.approx(known[here].sum(), rel=bias)
        off = np.sqrt(np.square(found[here] - known[here]).mean() / np.square(known[here]).mean())
        assert off < error


@given(
    st.lists(
        st.floats(-1e6, 1e6) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1250.0]),
        min_size=9,
        max_size=9,
    ),
    st.sampled_from([0.0, 0.02, 0.25, 1.0, 1e6]),
)
@settings(max_examples=100, deadline=None)
def test_a_lobe_is_finite_wherever_a_facet_lies(values: list[float], m: float) -> None:
    place, normal, view = np.array(values).reshape(3, 1, 3)
    lengths = [np.linalg.norm(each) for each in (normal, view)]
    if all(0 < length < np.inf for length in lengths):
        normal, view = normal / lengths[0], view / lengths[1]
    lobe = table_lobe(table("b"), place, normal, view, m)
    assert np.isfinite(lobe).all()
    assert (lobe >= 0).all()


@pytest.mark.parametrize("name", ["b", "l"])
@pytest.mark.parametrize("roughness", [0.2, 0.3])
def test_mirror_directions_find_facets_that_the_ratios_miss(name: str, roughness: float) -> None:
    lights = LIT[name]
    start, ours, _ = found(name, lights, roughness, 0.0, WIDE)
    np.testing.assert_allclose(start, 6.0, atol=1e-6)
    assert np.median(ours) < 0.8
    assert ours.mean() < 1.2


def test_ratios_saturate_at_the_step_and_less_so_in_linear_gradients() -> None:
    raw = {}
    for name, lights in LIT.items():
        reading = seen(lights, SIGHT.normals, 0.2)
        pairs = reading[:, 1:].reshape(-1, 3, 2)
        ratio = (pairs[..., 0] - pairs[..., 1]) / np.maximum(pairs.sum(axis=2), 1e-12)
        ratio /= np.maximum(np.linalg.norm(ratio, axis=1, keepdims=True), 1e-12)
        half = ratio + SIGHT.views
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        raw[name] = angle_deg(half, SIGHT.normals)[INNER].mean()
    assert raw["b"] > 6
    assert raw["l"] < 0.6 * raw["b"]


def test_noise_and_what_is_expected_share_the_normal() -> None:
    """Sigma is the error that is made; a narrow expectation holds the start where noise rules."""
    _, loud, sigma = found("b", BINARY, 0.25, 0.001, WIDE)
    assert 0.5 < np.sqrt((loud**2).mean() / 2) / np.sqrt((sigma**2).mean()) < 2
    _, held, kept = found("b", BINARY, 0.25, 0.1, MirrorConfig(spread_deg=0.5))
    assert abs(held.mean() - 6) < 0.5
    assert (kept < 0.5001).all()
    assert kept.min() > 0.3


def plain_costs(
    turns: np.ndarray, reading: np.ndarray, start: np.ndarray, view: np.ndarray, spread: float
) -> np.ndarray:
    """(k,) squared residuals of one pixel turned by (k, 2), the specular albedo at its best."""
    across = np.cross(start, [0.0, 0.0, 1.0] if abs(start[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    normal = start + turns @ np.stack([across, np.cross(start, across)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    centre = np.zeros_like(normal)
    lobe = table_lobe(table("b"), centre, normal, np.tile(view, (len(turns), 1)), 0.25).astype(
        float
    )
    s = np.maximum(lobe @ reading, 0) / np.maximum((lobe**2).sum(axis=1), 1e-30)
    misfit = (((reading - s[:, None] * lobe) / 5e-4) ** 2).sum(axis=1)
    return np.asarray(misfit + (turns**2).sum(axis=1) / spread**2)


def test_the_solution_is_the_twins_minimum() -> None:
    truth = bent(3.0)
    noise = np.random.default_rng(1).normal(0, 5e-4, (len(truth), 7))
    reading = seen(BINARY, truth, 0.25) + noise
    spread = math.radians(4)
    some = np.flatnonzero(INNER)[:: INNER.sum() // 12]
    result = mirror_normals(
        reading[some], np.full((len(some), 7), 5e-4), table("b"), np.zeros((len(some), 3)),
        SIGHT.normals[some], SIGHT.views[some], 0.25, MirrorConfig(spread_deg=4.0, rounds=12),
    )  # fmt: skip
    line = np.linspace(-0.15, 0.15, 41)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    for i, normal in zip(some, result.normal, strict=True):
        start = SIGHT.normals[i]
        stated = (reading[i], start, SIGHT.views[i], spread)
        across = np.cross(start, [0.0, 0.0, 1.0] if abs(start[2]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        along = normal / (normal @ start)
        mine = np.array([[along @ across, along @ np.cross(start, across)]])
        assert plain_costs(mine, *stated)[0] < plain_costs(grid, *stated).min() * 1.02 + 0.1


@given(
    st.lists(
        st.floats(-1e6, 1e6) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e300]),
        min_size=7,
        max_size=7,
    ),
    st.floats(-6, 6).map(lambda power: 10.0**power),
)
@settings(max_examples=60, deadline=None)
def test_facets_are_unit_and_finite_whatever_is_read(values: list[float], sigma: float) -> None:
    start = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    views = np.tile([0.0, 0.0, 1.0], (3, 1))
    reading = np.tile(np.array(values), (3, 1))
    result = mirror_normals(
        reading,
        np.full((3, 7), sigma),
        table("b"),
        np.zeros((3, 3)),
        start,
        views,
        0.25,
        MirrorConfig(),
    )
    assert np.isfinite(result.normal).all()
    assert np.isfinite(result.sigma_rad).all()
    np.testing.assert_allclose(np.linalg.norm(result.normal, axis=1), [1, 0, 1], atol=1e-9)


@given(st.floats(-6, 6).map(lambda power: 10.0**power))
@settings(max_examples=20, deadline=None)
def test_facets_do_not_depend_on_scale(scale: float) -> None:
    reading = seen(BINARY, bent(3.0), 0.25)[::40].astype(float)
    sigma = np.full(reading.shape, 1e-4)
    where = (
        table("b"),
        SIGHT.points_mm[::40],
        SIGHT.normals[::40],
        SIGHT.views[::40],
        0.25,
        MirrorConfig(),
    )
    one = mirror_normals(reading, sigma, *where)
    other = mirror_normals(reading * scale, sigma * scale, *where)
    np.testing.assert_allclose(other.normal, one.normal, atol=1e-4)


def test_detail_keeps_the_base_and_adds_relief() -> None:
    solved = np.ones(len(SIGHT.normals), bool)
    tilted = SIGHT.normals + np.array([0.2, 0.0, 0.0])
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    smooth = with_detail(SIGHT.normals, tilted, solved, SIGHT.mask, 3.0)
    assert (
        angle_deg(smooth, SIGHT.normals)[INNER].mean()
        < 0.5
        < angle_deg(tilted, SIGHT.normals).mean()
    )
    fine = bent(2.0)
    rough = with_detail(SIGHT.normals, fine, solved, SIGHT.mask, 3.0)
    assert angle_deg(rough, fine)[INNER].mean() < 0.6


# -- polarisers ---------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", ["cam0", "cam5", "cam7"])
def test_what_passes_of_each_lamp_is_what_the_simulator_lets_pass(camera: str) -> None:
    rig = default_rig()
    vertical = np.array([light.bank == "vertical" for light in rig.lights])
    _, known = facet_shares(rig, rig.camera(camera), PolariserConfig(np.inf, np.inf))
    found = mirror_amplitudes(rig.positions_mm, vertical, rig.camera(camera), np.zeros(3)) ** 2
    np.testing.assert_allclose(found, known, atol=1e-5)


def test_what_crossed_polarisers_leave_over_a_head_is_what_the_simulator_leaves() -> None:
    """At its surface, where a lamp is mirrored, half as much as at the stage's centre."""
    camera, lights = RIG.cameras[0], shots.rig_lights(RIG, SEQUENCES["binary-polarised"])
    horizontal = np.array([lamp.bank == "horizontal" for lamp in RIG.lights])
    lamps = RIG.positions_mm[horizontal]
    half = lamps / np.linalg.norm(lamps, axis=1, keepdims=True) + camera.centre_mm / 1100
    normals = half / np.linalg.norm(half, axis=1, keepdims=True)
    points = 80 * normals
    views = camera.centre_mm - points
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    _, known = polarised_factors(
        points, normals, views, lamps, lamp_axes(RIG)[horizontal],
        lens_axis(camera, PolariserConfig()), 1.4, np.inf, np.inf,
    )  # fmt: skip
    field = mirrored_of_lamps(lights, camera)
    number = [int(np.argmin(np.linalg.norm(lights.position_mm - x, axis=1))) for x in lamps]
    found = (field[0] + points @ field[1:])[:, number] ** 2
    front = np.flatnonzero(np.einsum("nk,nk->n", normals, views) > 0.5)
    centre, found, known = field[0, number][front] ** 2, found[front, front], known[front, front]
    np.testing.assert_allclose(found, known, atol=0.005)
    assert found.mean() < 0.6 * centre.mean()
    coarse = (mirror_lights(lights, camera).weight / lights.weight)[number][front]
    np.testing.assert_allclose(coarse, known, atol=0.005)


def test_shares_of_diffuse_light_are_what_the_simulator_lets_pass() -> None:
    rig, camera = RIG, RIG.cameras[0]
    lights = shots.rig_lights(rig, SEQUENCES["binary-polarised"])
    shares = diffuse_shares(lights, camera)[cells_of(SIGHT.normals)]
    place = camera.centre_mm / np.linalg.norm(camera.centre_mm)
    views = np.broadcast_to(place, SIGHT.normals.shape)
    factors, _ = polarised_factors(
        np.zeros_like(SIGHT.normals), SIGHT.normals, views, rig.positions_mm, lamp_axes(rig),
        lens_axis(camera, PolariserConfig()), 1.4, np.inf, np.inf,
    )  # fmt: skip
    toward = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    cosine = np.maximum(SIGHT.normals @ toward.T, 0)
    for k, name in enumerate(SEQUENCES["binary-polarised"]):
        lit = shots.pattern_levels(name, rig)
        bright = (cosine @ lit > 2) & INNER
        known = (cosine * factors) @ lit / np.maximum(cosine @ lit, 1e-9) / 0.5
        np.testing.assert_allclose(shares[bright, k], known[bright], atol=0.03)


def test_mirror_lights_change_the_lobe_of_lamps_by_their_bank() -> None:
    lights = shots.rig_lights(RIG, SEQUENCES["binary-polarised"])
    changed = mirror_lights(lights, RIG.cameras[0])
    crossed = np.array([name.endswith("@cross") for name in lights.patterns])
    before, after = lights.strength.sum(axis=1), changed.strength.sum(axis=1)
    assert (after[crossed] < 0.15 * before[crossed]).all()
    assert (after[~crossed] > 0.5 * before[~crossed]).all()
    assert not changed.polarised


# -- trust --------------------------------------------------------------------------------------


def trusted(chroma: float, noise: float = 0.002) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trust and sigma of a ball of this much chroma, and the errors that are really made."""
    far = far_field(BINARY)
    cell = cells_of(SIGHT.normals)
    light = np.einsum("npk,nk->np", far[cell], SIGHT.normals)
    bright = 0.4 * light
    rng = np.random.default_rng(5)
    loud = chroma * light + noise * np.sqrt(0.25 + bright) * rng.normal(size=light.shape)
    normal = solve_far_normals(loud.astype(np.float32), far, SIGHT.views, 5)
    stated = (far, cells_of(normal), normal, SIGHT.views, noise, 5.0)
    trust, sigma = normal_trust(loud, bright, *stated)
    return trust[INNER], np.degrees(sigma[INNER]), angle_deg(normal, SIGHT.normals)[INNER]


def test_sigma_is_the_error_that_noise_makes() -> None:
    for chroma in (0.15, 0.05):
        _, sigma, error = trusted(chroma)
        # An angle has two parts of sigma each.
        assert 0.8 < np.sqrt((error**2).mean() / 2) / np.sqrt((sigma**2).mean()) < 1.25


def test_trust_falls_as_chroma_does_and_is_half_at_the_sigma_named() -> None:
    means = [trusted(chroma)[0].mean() for chroma in (0.15, 0.05, 0.015, 0.005)]
    assert all(a > b for a, b in itertools.pairwise(means))
    assert means[0] > 0.95
    assert means[-1] < 0.35
    trust, sigma, _ = trusted(0.02)
    near = (sigma > 4.5) & (sigma < 5.5)
    assert near.any()
    assert trust[near].max() < 0.56


@given(
    st.lists(st.floats(-1e6, 1e6) | st.sampled_from([0.0, np.nan, np.inf]), min_size=7, max_size=7)
)
@settings(max_examples=40, deadline=None)
def test_trust_is_between_0_and_1_whatever_is_read(values: list[float]) -> None:
    far = far_field(dataclasses.replace(BINARY))[:2]
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    signal = np.tile(np.array(values), (2, 1))
    view = np.tile([0.0, 0.0, 1.0], (2, 1))
    trust, sigma = normal_trust(signal, signal, far, np.zeros(2, int), normal, view, 0.001, 5.0)
    assert ((trust >= 0) & (trust <= 1)).all()
    assert trust[1] == 0
    assert not np.isnan(sigma).any()
