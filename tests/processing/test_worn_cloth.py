"""Cloth that has a colour: found in the skin's mesh, and taken out of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lightstage.formats.mesh import Mesh
from lightstage.rig import default_rig
from processing.rays import MeshRays
from processing.reconstruction.pieces import larger_pieces
from processing.reconstruction.skin_pixels import skin_alone
from processing.reconstruction.views import View
from processing.reconstruction.worn import Coloured, may_wear, no_skin, without_worn
from tests.processing.test_given_meshes import ball_mesh, plate

SKIN = np.array([0.6, 0.45, 0.38])
RED, BLACK, HAIR = (0.4, 0.03, 0.02), (0.02, 0.02, 0.025), (0.25, 0.15, 0.1)
CAMERAS = default_rig().scaled(0.03).cameras
MIDDLE = np.zeros(3)


def views_of(ball: Mesh, bands: dict[tuple[float, float], tuple[float, ...]]) -> list[Coloured]:
    """What cameras see of a ball of skin that has bands of other colours, by height in mm."""
    rays, out = MeshRays(ball.vertices, ball.faces), []
    for camera in CAMERAS:
        hits = rays.cast_camera(camera)
        met = hits.face >= 0
        height = ball.vertices[ball.faces[np.where(met, hits.face, 0)], 1].mean(axis=1)
        colour = np.where(met[:, None], SKIN, 0)
        for (low, high), other in bands.items():
            colour[met & (height >= low) & (height < high)] = other
        out.append(Coloured(camera, colour.reshape(camera.height_px, camera.width_px, 3)))
    return out


def area_mm2(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@pytest.mark.parametrize("cloth", [RED, BLACK])
def test_cloth_below_the_face_goes_from_the_skin_to_the_occluders(cloth: tuple[float, ...]) -> None:
    ball, wall = ball_mesh(), plate(150, 60)
    skin, others = without_worn(ball, wall, views_of(ball, {(-95, -40): cloth}), MIDDLE)
    assert others is not None
    assert -55 < skin.vertices[:, 1].min() < -30
    cut = Mesh(others.vertices[len(wall.vertices) :], others.faces[2:] - len(wall.vertices))
    assert cut.vertices[:, 1].max() < -30
    np.testing.assert_array_equal(others.vertices[: len(wall.vertices)], wall.vertices)
    assert area_mm2(skin) + area_mm2(cut) == pytest.approx(area_mm2(ball))


@pytest.mark.parametrize(
    ("case", "bands"),
    [
        ("skin alone", {}),
        ("hair on the skull", {(50.0, 95.0): BLACK}),
        ("brown hair below", {(-95.0, -40.0): HAIR}),
        ("skin in shade", {(-95.0, -40.0): tuple(0.05 * SKIN)}),
        ("painted lips", {(-32.0, -28.0): RED}),
        ("nothing known there", {(-95.0, -40.0): (0.0, 0.0, 0.0)}),
    ],
)
def test_what_is_no_cloth_stays_in_the_skin(
    case: str, bands: dict[tuple[float, float], tuple[float, ...]]
) -> None:
    ball = ball_mesh()
    skin, others = without_worn(ball, None, views_of(ball, bands), MIDDLE)
    assert skin is ball, case
    assert others is None, case


def test_no_ray_is_cast_where_no_view_shows_other_colours_below_the_face() -> None:
    ball = ball_mesh()
    assert not may_wear(views_of(ball, {}), MIDDLE)
    assert not may_wear(views_of(ball, {(50.0, 95.0): BLACK}), MIDDLE)
    assert may_wear(views_of(ball, {(-95.0, -60.0): RED}), MIDDLE)
    black = [v._replace(colour=np.zeros_like(v.colour)) for v in views_of(ball, {})]
    assert may_wear(black, MIDDLE)  # not known


def test_cameras_that_see_nothing_leave_the_mesh_as_it_is() -> None:
    ball = ball_mesh()
    dark = [v._replace(colour=np.zeros_like(v.colour)) for v in views_of(ball, {})]
    away = Mesh(ball.vertices + np.array([0, 0, 1e5]), ball.faces)
    assert without_worn(ball, None, dark, MIDDLE)[0] is ball
    assert without_worn(away, None, views_of(ball, {}), MIDDLE)[0] is away


COLOURS = arrays.arrays(np.float64, (20, 3), elements=st.floats(0, 2, width=16))


@given(COLOURS, st.sampled_from([SKIN, np.array([0.1, 0.05, 0.03]), np.zeros(3)]))
def test_colours_are_no_skin_by_their_angle_and_their_length(
    colours: np.ndarray, face: np.ndarray
) -> None:
    found = no_skin(colours, face)
    for colour, other in zip(colours, found, strict=True):
        size = float(np.linalg.norm(colour))
        if size == 0 or not face.any():
            assert not other or size > 0
            continue
        cosine = float(colour @ face) / size / float(np.linalg.norm(face))
        angle = float(np.degrees(np.arccos(min(cosine, 1.0))))
        dark = size < 0.15 * float(np.linalg.norm(face))
        if min(abs(angle - 30), abs(angle - 7)) > 1e-3:
            assert other == (angle > 30 or (dark and angle > 7))


def test_pieces_are_chosen_by_their_own_area() -> None:
    large, small = plate(0, 40), plate(50, 10)
    both = Mesh(
        np.concatenate([large.vertices, small.vertices]),
        np.concatenate([large.faces, small.faces + 4]).astype(np.int32),
    )
    every = np.ones(4, bool)
    assert larger_pieces(both, every, 10.0).tolist() == [True, True, False, False]
    assert larger_pieces(both, every, 3.0).all()
    assert larger_pieces(both, ~every, 0.0).tolist() == [False] * 4
    assert larger_pieces(both, np.array([True, False, True, True]), 33.0).sum() == 0


def test_thin_regions_without_a_normal_and_what_is_beside_them_are_not_matched_as_skin() -> None:
    camera = CAMERAS[0]
    shape = (camera.height_px, camera.width_px)
    normals = np.zeros((*shape, 3), np.float32)
    normals[..., 2] = 1
    normals[30] = 0
    normals[60, 20:22] = 0  # a pupil
    normals[80:95, 10:60] = 0  # hair
    mask = np.ones(shape, bool)
    mask[:10] = False
    view = View(camera, np.ones((*shape, 4), np.float32), mask, normals)
    blind = dataclasses.replace(view, normals=np.zeros_like(normals))
    found, same = skin_alone([view, blind])
    assert same is blind
    gone = np.isnan(found.textures).all(axis=(1, 2))
    assert np.flatnonzero(gone).tolist() == [29, 30, 31]
    assert np.isfinite(found.textures[~gone]).all()
    assert found.mask is mask
    normals[30] = normals[0]
    assert skin_alone([view])[0] is view
