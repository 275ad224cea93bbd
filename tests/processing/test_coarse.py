"""The compiled coarse method against plain float64 twins, and its vectors against NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from lightstage.formats.half import as_float
from lightstage.patterns import pattern_levels
from lightstage.rig import Camera
from processing.lanes import (
    LANES,
    at_least,
    every,
    lane,
    largest,
    load,
    load_row,
    store,
    store_turned,
    totals,
)
from processing.lighting.interface import BARE, skin_interface
from processing.lighting.lamps import nominal_lamps
from processing.lighting.lights import PatternLights, far_field, lights_of
from processing.readings import px_per_mm
from processing.separation.colour import (
    Readings,
    camera_rays,
    separate_window,
    window_readings,
)
from processing.separation.config import SeparateConfig
from processing.separation.far_tables import far_tables
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps
from tests.processing import coarse_twin, lit_ball
from tests.processing.lit_ball import PATTERNS, Ball, angle_deg
from tests.processing.one_pass import as_stored, separate_at_once, stored

RIG = lit_ball.small_rig(factor=0.014)
CAMERA = RIG.cameras[0]
DRIVEN = np.stack([pattern_levels(name, RIG) for name in PATTERNS])
LIGHTS = lights_of(nominal_lamps(RIG), PATTERNS, DRIVEN)
BALL = Ball(coated=True)
SIGHT = lit_ball.see(BALL, CAMERA)
INNER = (SIGHT.normals * SIGHT.views).sum(axis=1) > 0.3
GOOD = np.ones(len(SIGHT.normals), bool)
CONFIG = dataclasses.replace(SeparateConfig(), iterations=30)
READ = lit_ball.photograph(BALL, SIGHT, RIG).astype(np.float32)


def maps_of(
    rgb: np.ndarray,
    config: SeparateConfig = CONFIG,
    lights: PatternLights = LIGHTS,
    camera: Camera | None = CAMERA,
) -> PixelMaps:
    return separate_at_once(pixels_of(rgb, camera), lights, config)


def pixels_of(rgb: np.ndarray, camera: Camera | None = CAMERA) -> Pixels:
    return Pixels(rgb, GOOD, SIGHT.views, SIGHT.mask, px_per_mm(CAMERA), camera)


def window_of(values: np.ndarray) -> Readings:
    """Readings of the whole picture from (n, P, 3) values of the ball."""
    images = np.zeros((values.shape[1], *SIGHT.mask.shape, 3), np.float32)
    images[:, SIGHT.mask] = values.transpose(1, 0, 2)
    valid = np.ones(SIGHT.mask.shape, bool)
    return window_readings(*stored(images), SIGHT.mask, valid, (0, 0), CAMERA)


def test_coarse_maps_agree_with_every_light_summed_in_float64() -> None:
    twin = coarse_twin.separate(pixels_of(READ), LIGHTS, CONFIG, CAMERA.centre_mm)
    maps = maps_of(READ)
    away = angle_deg(maps.diffuse_normal, twin.normal)
    assert np.median(away) < 0.2
    assert away[INNER].max() < 1
    assert np.abs(maps.albedo - twin.albedo)[INNER].mean() < 0.003
    assert np.abs(maps.specular - twin.specular)[INNER].mean() < 0.002
    truth = SIGHT.normals[INNER]
    ours, plain = (angle_deg(n[INNER], truth).mean() for n in (maps.diffuse_normal, twin.normal))
    assert ours < plain + 0.05


def test_confidence_is_that_of_the_light_however_it_is_stored() -> None:
    """A glint anywhere in a view's photographs has all of them stored over a larger number."""
    config = dataclasses.replace(CONFIG, noise=0.01)
    whole = window_of(READ)
    found = separate_window(whole, LIGHTS, config).confidence
    assert 0.2 < np.median(found[INNER]) < 0.95
    for times in (8, 64):
        scale = times * whole.scale
        other = dataclasses.replace(whole, values=whole.values / np.float16(times), scale=scale)
        again = separate_window(other, LIGHTS, config).confidence
        np.testing.assert_allclose(again, found, atol=1e-4)


def test_a_sigma_of_0_leaves_each_pixel_its_own_specular_albedo() -> None:
    config = dataclasses.replace(CONFIG, specular_pool_mm=0.0)
    other, one = READ.copy(), int(np.flatnonzero(INNER)[600])
    other[one, 1] *= 1.05
    change = np.abs(maps_of(other, config).specular - maps_of(READ, config).specular)
    assert np.flatnonzero(change > 1e-5).tolist() == [one]


@given(power=st.floats(-6, 6), seed=st.integers(0, 100))
@settings(max_examples=4, deadline=None)
def test_float32_is_within_a_ten_thousandth_of_float64_at_any_scale(
    power: float, seed: int
) -> None:
    scale = 10.0**power
    rng = np.random.default_rng(seed)
    rgb = as_stored(READ * (1 + 0.02 * rng.standard_normal(READ.shape)) * scale)
    # Nothing mirrored, no neighbours: what is left is each pixel's own.
    config = dataclasses.replace(
        CONFIG,
        dark_level=0.004 * scale,
        specular_prior=0.0,
        specular_prior_share=1e9,
        albedo_prior_power=0.0,
    )
    maps = maps_of(rgb, config)
    tables = far_tables(
        LIGHTS, CAMERA.centre_mm / np.linalg.norm(CAMERA.centre_mm), 0.25, skin_interface()
    )
    args = (SIGHT.views, SIGHT.mask, LIGHTS, tables, config, CAMERA.centre_mm)
    normal, albedo = coarse_twin.tabulated(rgb, *args)
    away = np.abs(maps.diffuse_normal - normal).max(axis=1)
    off = np.abs(maps.albedo - albedo).max(axis=1) / scale
    # Where a normal lies on the border of two cells, rounding decides which one is taken.
    assert np.quantile(away, 0.995) < 1e-5
    assert np.quantile(off, 0.995) < 1e-5
    assert away.max() < 0.03


def test_places_on_the_rays_make_normals_beside_the_centre_better() -> None:
    ball = Ball(radius_mm=40, centre_mm=(55.0, -45.0, 0.0), coated=True)
    sight = lit_ball.see(ball, CAMERA)
    rgb = lit_ball.photograph(ball, sight, RIG).astype(np.float32)
    valid, scale = np.ones(len(rgb), bool), px_per_mm(CAMERA)
    pixels = Pixels(rgb, valid, sight.views, sight.mask, scale)
    far, near = (
        angle_deg(
            separate_at_once(
                dataclasses.replace(pixels, camera=camera), LIGHTS, CONFIG
            ).diffuse_normal,
            sight.normals,
        )
        for camera in (None, CAMERA)
    )
    assert near.mean() < 0.6 * far.mean()


def test_a_window_gives_what_the_whole_picture_gives() -> None:
    whole = window_of(READ)
    rows, columns = (np.flatnonzero(SIGHT.mask.any(axis=axis)) for axis in (1, 0))
    top, left = int(rows[0]) // 2 * 2, int(columns[0]) // 2 * 2
    cut = (slice(top, rows[-1] + 1), slice(left, columns[-1] + 1))
    part = dataclasses.replace(
        whole,
        values=np.ascontiguousarray(whole.values[:, cut[0], cut[1]]),
        mask=whole.mask[cut],
        valid=whole.valid[cut],
        origin=(top, left),
    )
    one, other = (separate_window(x, LIGHTS, CONFIG) for x in (whole, part))
    for field in dataclasses.fields(one):
        away = np.abs(getattr(one, field.name) - getattr(other, field.name))
        assert np.quantile(away, 0.99) < 2e-4, field.name
        assert away[INNER].max() < 5e-3, field.name


def test_rays_between_those_found_are_the_cameras() -> None:
    camera = dataclasses.replace(CAMERA.scaled(4), dist=(-0.1, 0.05, 1e-3, -1e-3, 0.0))
    rays, exact = camera_rays(camera, 8), camera.pixel_rays()[1]
    np.testing.assert_allclose(rays[:-1, :-1], exact[::8, ::8], atol=1e-6)
    between = (rays[:-1, :-1] + rays[1:, :-1] + rays[:-1, 1:] + rays[1:, 1:]) / 4
    between /= np.linalg.norm(between, axis=2, keepdims=True)
    height, width = (side - side % 8 - 4 for side in exact.shape[:2])
    inner = exact[4:height:8, 4:width:8]
    np.testing.assert_allclose(between[: len(inner), : inner.shape[1]], inner, atol=5e-5)


def test_more_patterns_than_one_vector_holds_give_the_same_normals() -> None:
    twice = LIGHTS.of((*LIGHTS.patterns, *LIGHTS.patterns[:3]))
    assert len(twice.patterns) > LANES
    maps = maps_of(np.concatenate([READ, READ[:, :3]], axis=1), lights=twice)
    assert angle_deg(maps.diffuse_normal, SIGHT.normals)[INNER].mean() < 2
    doubled = maps_of(np.concatenate([READ, READ], axis=1), lights=LIGHTS.of(LIGHTS.patterns * 2))
    once = maps_of(READ)
    assert angle_deg(doubled.diffuse_normal, once.diffuse_normal)[INNER].max() < 0.05
    np.testing.assert_allclose(doubled.albedo[INNER], once.albedo[INNER], atol=1e-3)


def test_tables_are_the_far_field_with_stray_light_and_polarisers() -> None:
    rng = np.random.default_rng(3)
    lights = dataclasses.replace(
        LIGHTS,
        stray_rgb=rng.normal(0, 0.02, LIGHTS.stray_rgb.shape),
        diffuse_share=rng.uniform(0.5, 1, 7),
    )
    tables = far_tables(lights, np.array([0.0, 0.0, 1.0]), 0.25, BARE)
    found = tables.diffuse[:, 0, 3:6, :7].transpose(0, 2, 1)
    np.testing.assert_allclose(found, far_field(lights), atol=2e-5)
    assert not tables.diffuse[..., 7].any()
    assert not tables.lobe[..., 7].any()


@pytest.mark.parametrize("part", ["red", "blue", "mean"])
def test_normals_of_other_parts_of_rgb_are_right_without_gloss(part: str) -> None:
    matte = lit_ball.photograph(Ball(coated=True, specular=0.0), SIGHT, RIG).astype(np.float32)
    config = dataclasses.replace(CONFIG, normals=part)
    found = maps_of(matte, config).diffuse_normal
    # Half floats round each colour by itself.
    assert angle_deg(found, maps_of(matte).diffuse_normal)[INNER].max() < 0.3
    glossy = maps_of(READ, config).diffuse_normal
    assert angle_deg(glossy, found)[INNER].mean() > 1


def test_noise_lowers_the_confidence_of_dark_and_of_grey_pixels() -> None:
    light = maps_of(READ).confidence[INNER]
    dark = maps_of(READ * np.float32(0.05)).confidence[INNER]
    mean = READ.mean(axis=2, keepdims=True)
    pale = maps_of(mean + np.float32(0.25) * (READ - mean)).confidence[INNER]
    assert light.mean() > 0.9
    assert dark.mean() < light.mean() - 0.2
    assert pale.mean() < light.mean() - 0.02


WILD = st.floats(-1e6, 1e6, width=32) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e-6])


@given(st.lists(WILD, min_size=21, max_size=21), st.integers(0, 5))
@settings(max_examples=20, deadline=None)
def test_whatever_is_read_maps_are_finite_and_neighbours_untouched(
    values: list[float], every_other: int
) -> None:
    rgb = READ.copy()
    rgb[every_other::6] = np.array(values, np.float32).reshape(7, 3)
    maps = maps_of(rgb)
    for field in dataclasses.fields(maps):
        assert np.isfinite(getattr(maps, field.name)).all(), field.name
    length = np.linalg.norm(maps.diffuse_normal, axis=1)
    assert ((length == 0) | (np.abs(length - 1) < 1e-5)).all()
    assert not maps.confidence[length == 0].any()
    kept = np.ones(len(rgb), bool)
    kept[every_other::6] = False
    # The search for a normal begins at the pixel before: on a border of cells it may end beside.
    away = np.abs(maps.diffuse_normal[kept] - maps_of(READ).diffuse_normal[kept])
    assert np.quantile(away, 0.8) < 1e-3
    assert away.max() < 0.03


@njit
def _vectors(flat: np.ndarray, factor: float) -> float:
    found = load(flat, 0) * every(np.float32(factor)) + load(flat, 8)
    store(flat, 0, at_least(found - load(flat, 8), load(flat, 8)))
    return largest(found)


@njit
def _tables(bits: np.ndarray, turned: np.ndarray, sums: np.ndarray) -> None:
    a, b, c, d = load_row(bits, 0), load_row(bits, 8), load_row(bits, 16), load_row(bits, 24)
    e, f, g, h = load_row(bits, 32), load_row(bits, 40), load_row(bits, 48), load_row(bits, 56)
    store_turned(turned, 0, a, b, c, d, e, f, g, h)
    found = totals(a, b, c, d, e, f, g, h)
    for k in range(8):
        sums[k] = lane(found, k)


@njit
def _floats(bits: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(bits)):
        out[i] = as_float(bits[i])


def test_lanes_reckon_as_numpy_does() -> None:
    flat = np.random.default_rng(0).normal(size=16).astype(np.float32)
    first, second = flat[:8].copy(), flat[8:].copy()
    found = _vectors(flat, 3.0)
    together = first * np.float32(3) + second
    np.testing.assert_allclose(found, together.max(), rtol=1e-5)
    np.testing.assert_allclose(flat[:8], np.maximum(together - second, second), rtol=1e-5)
    np.testing.assert_array_equal(flat[8:], second)


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_lanes_turn_tables_and_sum_their_rows(kind: type) -> None:
    table = np.random.default_rng(1).normal(size=(8, 8)).astype(kind)
    bits = table.ravel().view(np.uint16) if kind is np.float16 else table.ravel()
    turned, sums = np.zeros(64, np.float32), np.zeros(8, np.float32)
    _tables(bits, turned, sums)
    np.testing.assert_array_equal(turned.reshape(8, 8), table.T.astype(np.float32))
    np.testing.assert_allclose(sums, table.astype(np.float32).sum(axis=1), atol=1e-5)


def test_every_half_float_is_turned_exactly() -> None:
    bits = np.arange(65536).astype(np.uint16)
    out = np.zeros(65536, np.float32)
    _floats(bits, out)
    np.testing.assert_array_equal(out, bits.view(np.float16).astype(np.float32))
    _floats(out, out)
    np.testing.assert_array_equal(out, bits.view(np.float16).astype(np.float32))
