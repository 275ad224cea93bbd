"""What a photograph's pixels become before they are texels: the person alone, and enlarged."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
import torch

from learning.checkpoint import load_super_resolution, shipped_super_resolution
from learning.photo.enlarge import enlarged, texels_a_pixel
from learning.photo.foreground import foreground
from learning.photo.model import ShapeModel
from learning.photo.picture import read_photograph
from learning.photo.unwrap import Unwrapped, unwrap, without_slivers
from learning.render.uv import rasterise
from learning.render.view import render_view
from learning.upscale.network import Rcan
from tests.learning.photo.scene import Shot, camera_at

ROWS = 192


@pytest.fixture(scope="module")
def network() -> Rcan:
    torch.set_num_threads(1)
    return load_super_resolution(shipped_super_resolution())[0]


def test_a_larger_mesh_leaves_the_wall_behind_the_person_out(shot: Shot, model: ShapeModel) -> None:
    rgb = read_photograph(shot.path).rgb_linear
    size = (ROWS, ROWS * 2 // 3)
    ones = np.ones((*size, 3), np.float32)
    _, alpha = render_view(ones, np.ones(size, bool), shot.mesh, shot.camera, 0.0)
    there = alpha > 0.5
    wall = np.array([0.1, 0.25, 0.3], np.float32)
    noise = np.random.default_rng(0).normal(0, 0.01, rgb.shape)
    photograph = np.where(there[..., None], rgb, wall + noise).astype(np.float32)
    middle = shot.mesh.vertices.mean(axis=0)
    larger = shot.mesh.with_vertices(1.07 * (shot.mesh.vertices - middle) + middle)
    _, outline = render_view(ones, np.ones(size, bool), larger, shot.camera, 0.0)
    # The border itself is between two pixels of the coarser picture that is cut.
    border = cv2.dilate(there.astype(np.uint8), np.ones((7, 7))) > 0
    beside = (outline > 0.5) & ~border
    assert beside.sum() > 1000
    found = foreground(photograph, larger, model.face, shot.camera)
    assert found[beside].mean() < 0.1
    assert found[there].mean() > 0.95
    # Its texels then show the person alone.
    raster = rasterise(larger, *size)
    with_wall = unwrap(photograph, larger, raster, shot.camera)
    alone = unwrap(photograph, larger, raster, shot.camera, found)
    assert alone.seen.sum() > 0.7 * with_wall.seen.sum()
    near = np.abs(alone.texture[alone.seen] - wall).max(axis=1) < 0.05
    assert near.mean() < 0.01
    np.testing.assert_array_equal(alone.texture[alone.seen], with_wall.texture[alone.seen])


def test_a_collar_leaves_no_line_on_the_neck(shot: Shot, model: ShapeModel) -> None:
    rgb = read_photograph(shot.path).rgb_linear
    raster = rasterise(shot.mesh, ROWS, ROWS * 2 // 3)
    chin = int(shot.camera.project(shot.mesh.vertices[model.face])[0][:, 1].max())
    neck = unwrap(rgb, shot.mesh, raster, shot.camera).texture
    # A collar that rises to one side, with the soft edge of a photograph.
    row, column = np.mgrid[: rgb.shape[0], : rgb.shape[1]]
    share = np.clip(row - (chin + 12 + 0.05 * column), 0, 2)[..., None] / 2
    photograph = ((1 - share) * rgb + share * 0.004).astype(np.float32)
    found = foreground(photograph, shot.mesh, model.face, shot.camera)
    shown = unwrap(photograph, shot.mesh, raster, shot.camera, found)
    # The neck is there, of .25. The collar itself would be .24 off: of thousands of texels a few
    # along its soft edge have a part of it, less than half.
    beside = np.abs(shown.texture - neck).max(axis=2)[shown.seen]
    assert shown.seen.sum() > 2000
    assert (beside > 0.05).mean() < 0.002
    assert beside.max() < 0.12


def test_slivers_of_the_outline_are_left_out_and_eyes_stay() -> None:
    seen = np.zeros((60, 40), bool)
    seen[10:50, 8:32] = True
    seen[20:26, 12:18] = False
    eye, ear = np.zeros((2, *seen.shape), bool)
    eye[22:24, 14:16] = True
    ear[15:30, 36] = True
    neck = np.zeros_like(seen)
    neck[53:58, 10:30] = True
    texture = np.ones((*seen.shape, 3), np.float32)
    whole = Unwrapped(texture, seen | eye | ear | neck, np.ones(seen.shape, np.float32))
    found = without_slivers(whole, keep=eye)
    np.testing.assert_array_equal(found.seen, seen | eye | neck)
    assert not found.texture[ear].any()
    np.testing.assert_array_equal(without_slivers(whole, keep=ear).seen, seen | ear | neck)
    nothing = Unwrapped(texture, np.zeros_like(seen), whole.facing)
    assert not without_slivers(nothing, keep=eye).seen.any()


def test_a_photograph_of_few_pixels_shows_as_much_of_the_face(shot: Shot) -> None:
    raster = rasterise(shot.mesh, ROWS, ROWS * 2 // 3)

    def seen(scale: float) -> np.ndarray:
        camera = shot.camera.scaled(scale)
        grey = np.full((camera.height_px, camera.width_px, 3), 0.3, np.float32)
        return unwrap(grey, shot.mesh, raster, camera).seen

    usual = seen(2.0)
    for scale in (1 / 8, 1 / 2, 8.0):
        # Most that differs is at the picture's border and beside the nose.
        assert (seen(scale) != usual).sum() < 0.06 * usual.sum()
    # A small face in a large photograph.
    width, height = shot.camera.width_px, shot.camera.height_px
    padded = dataclasses.replace(
        shot.camera,
        width_px=9 * width,
        height_px=9 * height,
        cx_px=shot.camera.cx_px + 4 * width,
        cy_px=shot.camera.cy_px + 4 * height,
    )
    grey = np.full((padded.height_px, padded.width_px, 3), 0.3, np.float32)
    found = unwrap(grey, shot.mesh, raster, padded).seen
    assert (found != usual)[usual].sum() < 0.06 * usual.sum()


def test_without_a_wall_all_pixels_are_the_persons(shot: Shot, model: ShapeModel) -> None:
    near = camera_at(0.0, focal_px=6000.0)
    rgb = np.full((near.height_px, near.width_px, 3), 0.3, np.float32)
    assert foreground(rgb, shot.mesh, model.face, near).all()


@pytest.mark.parametrize("value", [0.0, 1.0, 1e6, -1.0])
def test_a_picture_of_one_colour_gives_some_mask(
    shot: Shot, model: ShapeModel, value: float
) -> None:
    rgb = np.full((shot.camera.height_px, shot.camera.width_px, 3), value, np.float32)
    assert foreground(rgb, shot.mesh, model.face, shot.camera).shape == rgb.shape[:2]


def test_an_enlarged_photograph_shows_each_texel_what_the_photograph_does(
    shot: Shot, model: ShapeModel, network: Rcan
) -> None:
    camera = camera_at(15.0).scaled(0.28)
    raster = rasterise(shot.mesh, ROWS, ROWS * 2 // 3)
    times = texels_a_pixel(shot.mesh, raster, model.face, camera)
    assert 1.5 < times < 5
    # A colour that tells the place in the picture, not far from skin's, which the network knows.
    row, column = np.mgrid[: camera.height_px, : camera.width_px]
    rgb = np.stack([row / camera.height_px, column / camera.width_px, 0 * row], axis=2)
    rgb = ((0.45, 0.3, 0.3) + 0.25 * (rgb - 0.5)).astype(np.float32)
    person = np.ones(rgb.shape[:2], bool)
    person[: camera.height_px // 2] = False
    found = enlarged(rgb, person, shot.mesh, raster, model.face, camera, network)
    assert found is not None
    one = unwrap(rgb, shot.mesh, raster, camera, person)
    other = unwrap(found.rgb_linear, shot.mesh, raster, found.camera, found.person)
    both = one.seen & other.seen
    # A coarse picture has wide edges of depth, from which no texel is taken.
    assert both.sum() > 0.95 * one.seen.sum() > 300
    np.testing.assert_allclose(one.texture[both], other.texture[both], atol=0.002)


@pytest.mark.parametrize("scale", [0.08, 2.0])
def test_a_photograph_of_enough_or_of_far_too_few_pixels_stays_as_it_is(
    shot: Shot, model: ShapeModel, network: Rcan, scale: float
) -> None:
    camera = camera_at(15.0).scaled(scale)
    raster = rasterise(shot.mesh, ROWS, ROWS * 2 // 3)
    rgb = np.full((camera.height_px, camera.width_px, 3), 0.3, np.float32)
    person = np.ones(rgb.shape[:2], bool)
    assert enlarged(rgb, person, shot.mesh, raster, model.face, camera, network) is None
