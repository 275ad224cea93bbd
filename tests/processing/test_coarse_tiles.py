"""The coarse method by tiles, where pixels are fine, against plain twins and against each pixel."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from lightstage.rig import Camera
from processing.lanes import LANES, lane, load
from processing.lighting.interface import skin_interface
from processing.readings import px_per_mm
from processing.separation.coarse_tile import TILE_ROWS
from processing.separation.colour import separate_window, window_readings
from processing.separation.config import SeparateConfig
from processing.separation.far_tables import far_tables
from processing.separation.triples import load_triples, over_root, store_triples
from processing.view_maps import PixelMaps
from tests.processing import coarse_twin, lit_ball
from tests.processing.lit_ball import PATTERNS, Ball, angle_deg
from tests.processing.one_pass import as_stored, stored

SIDE = (60, 84)


def piece(left_px: float, top_px: float) -> Camera:
    """A small piece of a camera of 16 pixels a millimetre, from so far right and below its axis."""
    whole = lit_ball.small_rig(factor=1.0).cameras[0]
    return dataclasses.replace(
        whole, width_px=SIDE[1], height_px=SIDE[0], cx_px=-left_px, cy_px=-top_px
    )


CAMERA = piece(420.0, -300.0)
RIG = lit_ball.small_rig(factor=0.014)
LIGHTS = lit_ball.lights_of_rig(RIG)
BALL = Ball(coated=True)
SIGHT = lit_ball.see(BALL, CAMERA)
READ = lit_ball.photograph(BALL, SIGHT, RIG).astype(np.float32)
IMAGES = np.ascontiguousarray(READ.transpose(1, 0, 2).reshape(len(PATTERNS), *SIDE, 3))
CONFIG = dataclasses.replace(SeparateConfig(), iterations=30)
BY_PIXEL = dataclasses.replace(CONFIG, tile_mm=0.0)
FREE = dataclasses.replace(
    CONFIG, specular_prior=0.0, specular_prior_share=1e9, albedo_prior_power=0.0
)


def maps_of(
    images: np.ndarray,
    config: SeparateConfig = CONFIG,
    mask: np.ndarray | None = None,
    valid: np.ndarray | None = None,
) -> PixelMaps:
    mask = np.ones(images.shape[1:3], bool) if mask is None else mask
    valid = np.ones(images.shape[1:3], bool) if valid is None else valid
    readings = window_readings(*stored(images), mask, valid, (0, 0), CAMERA)
    return separate_window(readings, LIGHTS, config)


def test_the_ball_fills_the_picture() -> None:
    assert SIGHT.mask.all()
    assert LANES / px_per_mm(CAMERA) <= CONFIG.tile_mm


def test_tiles_give_what_every_pixel_by_itself_gives() -> None:
    rng = np.random.default_rng(1)
    noisy = IMAGES + (0.001 * np.sqrt(0.25 + IMAGES) * rng.standard_normal(IMAGES.shape)).astype(
        np.float32
    )
    for images, away_deg in ((IMAGES, 0.2), (noisy, 0.4)):
        tiles, pixels = maps_of(images), maps_of(images, BY_PIXEL)
        away = angle_deg(tiles.diffuse_normal, pixels.diffuse_normal)
        assert away.mean() < away_deg
        wrong = [angle_deg(m.diffuse_normal, SIGHT.normals).mean() for m in (tiles, pixels)]
        assert wrong[0] < wrong[1] + 0.02
        np.testing.assert_allclose(tiles.albedo, pixels.albedo, atol=0.01)
        assert np.abs(tiles.albedo - pixels.albedo).mean() < 1.5e-3
        np.testing.assert_allclose(tiles.specular, pixels.specular, atol=1e-3)
        np.testing.assert_allclose(tiles.confidence, pixels.confidence, atol=0.05)


@given(power=st.floats(-6, 6), seed=st.integers(0, 100))
@settings(max_examples=4, deadline=None)
def test_tiles_are_within_a_ten_thousandth_of_float64_at_any_scale(power: float, seed: int) -> None:
    scale = 10.0**power
    rng = np.random.default_rng(seed)
    images = as_stored(IMAGES * (1 + 0.02 * rng.standard_normal(IMAGES.shape)) * scale)
    good = rng.random(SIDE) > 0.02
    config = dataclasses.replace(FREE, dark_level=0.004 * scale)
    maps = maps_of(images, config, valid=good)
    middle = CAMERA.centre_mm / np.linalg.norm(CAMERA.centre_mm)
    tables = far_tables(LIGHTS, middle, 0.25, skin_interface())
    normal = maps.diffuse_normal.reshape(*SIDE, 3)
    albedo = maps.albedo.reshape(*SIDE, 3)
    apart, off = [], []
    for top in range(0, SIDE[0], TILE_ROWS):
        for left in range(0, SIDE[1] - LANES + 1, LANES):
            cut = (slice(top, top + TILE_ROWS), slice(left, left + LANES))
            view = SIGHT.views.reshape(*SIDE, 3)[cut].mean(axis=(0, 1))
            view /= np.linalg.norm(view)
            point = CAMERA.centre_mm - (CAMERA.centre_mm @ view) * view
            rgb, here = images[:, cut[0], cut[1]].transpose(1, 2, 0, 3), good[cut]
            own = coarse_twin.tiled(rgb, here, view, point, LIGHTS, tables, config)
            apart.append(np.abs(normal[cut][here] - own[0]).max())
            off.append(np.abs(albedo[cut][here] - own[1]).max() / scale)
    # A tile's normal on the border of two cells, or a pixel far from it, is found otherwise.
    assert np.quantile(apart, 0.8) < 1e-4
    assert np.quantile(off, 0.8) < 1e-4
    assert not maps.confidence[~good.ravel()].any()


def test_masks_of_any_form_are_solved_where_they_are() -> None:
    rng = np.random.default_rng(4)
    whole = maps_of(IMAGES, FREE)
    mask = rng.random(SIDE) > 0.3
    mask[:, 30:37] = False
    part = maps_of(IMAGES, FREE, mask)
    at = mask.ravel()
    assert angle_deg(part.diffuse_normal, whole.diffuse_normal[at]).max() < 0.7
    np.testing.assert_allclose(part.albedo, whole.albedo[at], atol=0.01)
    for rows, columns in ((3, 9), (60, 8), (5, 81), (1, 84)):
        cut = np.ascontiguousarray(IMAGES[:, :rows, :columns])
        maps = maps_of(cut, FREE)
        inner = np.zeros(SIDE, bool)
        inner[:rows, :columns] = True
        away = angle_deg(maps.diffuse_normal, whole.diffuse_normal[inner.ravel()])
        assert away.max() < 0.7
        assert (maps.confidence > 0.5).all()


def test_a_mark_of_another_normal_is_solved_by_itself() -> None:
    other = lit_ball.see(BALL, piece(-900.0, 500.0))
    read = lit_ball.photograph(BALL, other, RIG).astype(np.float32)
    mixed, truth = IMAGES.copy(), SIGHT.normals.reshape(*SIDE, 3).copy()
    spot = (slice(21, 23), slice(34, 37))
    mixed[:, spot[0], spot[1]] = read.transpose(1, 0, 2).reshape(IMAGES.shape)[:, spot[0], spot[1]]
    truth[spot] = other.normals.reshape(*SIDE, 3)[spot]
    tiles, pixels = maps_of(mixed), maps_of(mixed, BY_PIXEL)
    at = np.ravel_multi_index(np.mgrid[spot].reshape(2, -1), SIDE)
    away = angle_deg(tiles.diffuse_normal, pixels.diffuse_normal)
    assert angle_deg(truth.reshape(-1, 3)[at], SIGHT.normals[at]).min() > 20
    assert away[at].max() < 0.2
    assert away.max() < 0.7


WILD = st.floats(-1e6, 1e6, width=32) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e-6, 1e30])


@given(st.lists(WILD, min_size=21, max_size=21), st.integers(0, 5), st.sampled_from([1, 7, 40]))
@settings(max_examples=20, deadline=None)
def test_whatever_is_read_tiles_are_finite(values: list[float], first: int, every: int) -> None:
    images = IMAGES.reshape(len(PATTERNS), -1, 3).copy()
    images[:, first::every] = np.array(values, np.float32).reshape(7, 1, 3)
    maps = maps_of(images.reshape(IMAGES.shape))
    for field in dataclasses.fields(maps):
        assert np.isfinite(getattr(maps, field.name)).all(), field.name
    length = np.linalg.norm(maps.diffuse_normal, axis=1)
    assert ((length == 0) | (np.abs(length - 1) < 1e-5)).all()
    assert not maps.confidence[length == 0].any()


def test_pixels_that_cannot_be_used_leave_their_tile_alone() -> None:
    images, whole = IMAGES.copy(), maps_of(IMAGES, FREE)
    images[:, 10, 10] = np.nan
    images[2, 30, 41] = np.inf
    images[..., 50, 60, :] = 0
    images[..., 51, 61, 2] = 0  # a dead channel
    images[:, 22, 22] = images[:, 22, 22].mean(axis=1, keepdims=True)  # grey
    maps = maps_of(images, FREE)
    bad = np.zeros(SIDE, bool)
    for place in ((10, 10), (30, 41), (50, 60), (51, 61), (22, 22)):
        bad[place] = True
    np.testing.assert_array_equal(maps.confidence.reshape(SIDE) == 0, bad)
    for field in dataclasses.fields(maps):
        assert not getattr(maps, field.name)[bad.ravel()].any() or field.name == "roughness"
    away = np.abs(maps.diffuse_normal - whole.diffuse_normal)[~bad.ravel()].max(axis=1)
    # Those of the tiles that lack a pixel lie in another cell at times.
    assert np.quantile(away, 0.9) < 1e-5
    assert away.max() < 0.01


@njit
def _there_and_back(bits: np.ndarray, out: np.ndarray, roots: np.ndarray) -> None:
    red, green, blue = load_triples(bits, 1)
    store_triples(out, 2, blue, red, green)
    found = over_root(load(roots, 0))
    for i in range(8):
        roots[i] = lane(found, i)


def test_triples_are_parted_and_laid_beside_each_other() -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(size=30).astype(np.float16)
    out, roots = np.zeros(30, np.float32), rng.uniform(0.1, 9, 8).astype(np.float32)
    wanted = 1 / np.sqrt(roots)
    _there_and_back(values.view(np.uint16), out, roots)
    expected = values[1:25].reshape(8, 3).astype(np.float32)[:, [2, 0, 1]]
    np.testing.assert_array_equal(out[2:26].reshape(8, 3), expected)
    assert not out[:2].any()
    assert not out[26:].any()
    np.testing.assert_allclose(roots, wanted, rtol=1e-6)
