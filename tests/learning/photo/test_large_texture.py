"""Textures of more rows than those in which light and skin are sought."""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning.checkpoint import load_whole_face, shipped_weights
from learning.photo import fit
from learning.photo.fit import FittedHead, fit_head
from learning.photo.large_texture import Enlarging, Shown, brighter, finest, rows_of_search
from learning.photo.picture import read_photograph
from learning.photo.shape_fit import Photograph, Places
from learning.render.uv import UvRaster, rasterise
from lightstage.formats.mesh import Mesh
from lightstage.formats.template import Template
from lightstage.rig import Camera, look_at
from tests.learning.photo.scene import FOCAL_PX, SMALL, Shot

ROWS, SEARCH_ROWS = 192, 96
SIDE_MM = np.array([100.0, 150.0])


def plate() -> Mesh:
    """A rectangle before the camera; its texture's border is empty."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    place = np.column_stack([(corners - 0.5) * SIDE_MM, np.zeros(4)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(place, faces, uvs=0.1 + 0.8 * corners, face_uvs=faces)


def camera(pixels: int) -> Camera:
    place = np.array([0.0, 0.0, 500.0])
    pose = look_at(place, np.zeros(3))
    middle = pixels / 2
    return Camera(
        "c", "", "", pixels, pixels, 3 * pixels, 3 * pixels, middle, middle, (0.0,) * 5, pose
    )


def pattern(place: np.ndarray) -> np.ndarray:
    """(..., 3) what a plate shows at (..., 2) places in mm: stripes in a light that fades."""
    across, up = place[..., 0], place[..., 1]
    stripes = 0.2 * np.sin(2 * np.pi * across / 4.0) * np.cos(2 * np.pi * up / 5.0)
    grey = 0.4 * np.exp(stripes + across / 200)
    return np.stack([grey, 0.8 * grey, 0.6 * grey], axis=-1)


def picture(taken: Camera) -> np.ndarray:
    column, row = np.meshgrid(np.arange(taken.width_px) + 0.5, np.arange(taken.height_px) + 0.5)
    scale = 500 / taken.fx_px
    middle = taken.width_px / 2
    place = np.stack([(column - middle) * scale, (middle - row) * scale], axis=2)
    return pattern(place).astype(np.float32)


def seen_by(taken: Camera, texels: np.ndarray, texels_a_pixel: float) -> Shown:
    return Shown(picture(taken), taken, plate(), texels, texels_a_pixel)


def rasters() -> tuple[UvRaster, UvRaster]:
    low, large = (rasterise(plate(), rows, rows * 2 // 3) for rows in (SEARCH_ROWS, ROWS))
    return low, large


@pytest.mark.parametrize("pixels", [600, 2400])
def test_what_is_finer_than_the_search_is_the_photographs(pixels: int) -> None:
    low, large = rasters()
    finer = rasterise(plate(), 4 * ROWS, 4 * ROWS * 2 // 3)
    shows = pattern(finer.interpolate(plate().vertices)[..., :2])
    true, means = (
        cv2.resize(shows, each.covered.shape[::-1], interpolation=cv2.INTER_AREA)
        for each in (large, low)
    )
    width_mm = 500 / (3 * pixels)
    shown = seen_by(camera(pixels), low.covered, width_mm * SEARCH_ROWS * 0.8 / SIDE_MM[1])
    found = finest([shown], large)
    inside = cv2.erode(large.covered.astype(np.uint8), np.ones((9, 9))) > 0
    without = Enlarging(low.covered, large).map(means)
    off, left = (
        np.sqrt(np.square(np.log(image[inside] / true[inside])).mean())
        for image in (without, brighter(without.copy(), found))
    )
    assert off > 0.03
    assert left < 0.25 * off
    assert not found[~large.covered].any()


def test_a_photograph_with_fewer_pixels_than_the_search_has_texels_shows_nothing_finer() -> None:
    low, large = rasters()
    assert not finest([seen_by(camera(60), low.covered, 1.3)], large).any()


def test_each_texel_is_from_its_own_photograph() -> None:
    low, large = rasters()
    left = low.covered & (np.arange(low.covered.shape[1]) < 32)
    one = seen_by(camera(600), left, 0.4)
    blank = dataclasses.replace(
        one, rgb_linear=np.full_like(one.rgb_linear, 0.3), texels=low.covered & ~left
    )
    found = np.abs(finest([one, blank], large)).max(axis=2)
    assert found[:, :60].max() > 0.05
    assert found[:, 64:].max() < 1e-6


def test_maps_are_enlarged_without_fading_at_their_border() -> None:
    low, large = rasters()
    to_all = Enlarging(low.covered, large)
    even = to_all.map(np.where(low.covered, 0.5, 0))
    np.testing.assert_allclose(even[large.covered], 0.5, rtol=1e-6)
    assert not even[~large.covered].any()
    assert set(np.unique(to_all.labels(np.full(low.covered.shape, -1)))) == {-1}


def test_normals_are_the_meshs_own_turned_as_those_of_the_search() -> None:
    low, large = rasters()
    to_all = Enlarging(low.covered, large)
    fold, finer = (np.zeros((*each.covered.shape, 3)) for each in (low, large))
    for normals in (fold, finer):
        middle = normals.shape[1] // 2
        normals[:, :middle], normals[:, middle:] = (0.6, 0, 0.8), (-0.6, 0, 0.8)
    same = to_all.normals(fold, fold, finer)
    np.testing.assert_allclose(same[large.covered], finer[large.covered], atol=1e-6)
    turned = fold + np.array([0, 0.1, 0])
    turned /= np.linalg.norm(turned, axis=2, keepdims=True)
    found = to_all.normals(turned, fold, finer)[large.covered]
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(found[:, 1], 0.1, atol=0.01)


def test_a_large_head_is_the_smaller_one_with_the_photographs_detail(
    shot: Shot, template: Template, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    photograph = Photograph("p", read_photograph(shot.path).rgb_linear, shot.landmarks_px, FOCAL_PX)
    network, _ = load_whole_face(shipped_weights())
    config = dataclasses.replace(SMALL, rows=384, search_rows=192, rounds=1, refine_seconds=5)
    searched = []
    enlarge = fit._with_all_rows

    def kept(fitted: FittedHead, *given: Any) -> FittedHead:
        searched.append(fitted)
        return enlarge(fitted, *given)

    monkeypatch.setattr(fit, "_with_all_rows", kept)
    large = fit_head([photograph], template, places, network, config)
    (small,) = searched
    assert large.light is small.light is not None
    for name, image in large.inferred.maps.items():
        assert image.shape[:2] == (384, 256), name
    covered = rasterise(large.shape.meshes[0], 384, 256).covered
    assert not large.seen[~covered].any()
    np.testing.assert_array_equal(large.source >= 0, large.seen)
    inside = cv2.erode(small.seen.astype(np.uint8), np.ones((5, 5))) > 0
    for made, known in (
        (large.texture, small.texture),
        (large.inferred.maps["diffuse_albedo"], small.inferred.maps["diffuse_albedo"]),
    ):
        size = known.shape[1::-1]
        means = cv2.resize(made, size, interpolation=cv2.INTER_AREA)
        off = np.log((means + 0.01) / (known + 0.01))[inside]
        assert np.sqrt((off**2).mean()) < 0.03


@given(st.integers(64, 4096), st.integers(192, 3072))
def test_the_search_has_a_whole_part_of_the_rows(thirds: int, most: int) -> None:
    rows = 3 * thirds
    found = rows_of_search(rows, most)
    assert found % 3 == 0
    assert 0 < found <= min(rows, most + 2)
    assert (found == rows) == (rows <= most)
    assert abs(found - rows / round(rows / found)) <= 1.5
