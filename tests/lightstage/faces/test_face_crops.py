"""Squares that overlap become one face; a crop shows what its place says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.faces import blazeface, face_mesh
from lightstage.faces.face_mesh import Crop

ANY = st.floats(allow_nan=True, allow_infinity=True, width=32)
SQUARES = st.lists(st.tuples(st.floats(0.01, 1), ANY, ANY, ANY), max_size=8)


def arrays(squares):
    values = np.array(squares, float).reshape(-1, 4)
    points = np.repeat(values[:, None, 1:3], 6, axis=1)
    return values[:, 0], values[:, 1:3], values[:, 3], points


def plain(squares, overlap):
    """Heaps of squares and their means, by loops."""
    left = [s for s in squares if np.isfinite(s).all() and s[3] > 0]
    left.sort(key=lambda s: -s[0])
    out = []
    while left:
        best, heap, others = left[0], [], []
        for square in left:
            sides = [
                max(
                    0.0,
                    min(best[i] + best[3] / 2, square[i] + square[3] / 2)
                    - max(best[i] - best[3] / 2, square[i] - square[3] / 2),
                )
                for i in (1, 2)
            ]
            both = sides[0] * sides[1]
            union = best[3] ** 2 + square[3] ** 2 - both
            alike = square is best or (union > 0 and both / union > overlap)
            (heap if alike else others).append(square)
        weight = sum(s[0] for s in heap)
        out.append([sum(s[0] * s[i] for s in heap) / weight for i in (1, 2, 3)])
        left = others
    return out


@given(st.lists(st.tuples(*[st.floats(0.01, 1)] * 4), max_size=12))
def test_heaps_of_squares_are_a_plain_loops(squares):
    found = blazeface.blended(*arrays(squares), overlap=0.3)
    twin = plain(squares, 0.3)
    assert len(found) == len(twin)
    for face, expected in zip(found, twin, strict=True):
        assert np.allclose([*face.centre_px, face.size_px], expected)
        assert np.allclose(face.points_px, expected[:2])


@given(SQUARES)
def test_squares_that_are_none_are_left_out(squares):
    with np.errstate(all="ignore"):
        found = blazeface.blended(*arrays(squares), overlap=0.3)
    assert all(face.size_px > 0 for face in found)
    assert len(found) <= sum(bool(np.isfinite(s).all() and s[3] > 0) for s in squares)


def test_anchors_are_the_centres_of_their_cells():
    anchors = blazeface.anchors()
    assert anchors.shape == (896, 2)
    assert np.allclose(anchors[:2], 0.5 / 16)
    assert np.allclose(anchors[2], [1.5 / 16, 0.5 / 16])
    assert np.allclose(anchors[512:518], 0.5 / 8)


@pytest.mark.parametrize("size_px", [60.0, 192.0, 700.0])
@pytest.mark.parametrize("angle", [0.0, 0.4, -1.2])
def test_a_crop_shows_the_pixels_of_its_place(size_px, angle):
    y, x = np.mgrid[:1000, :1000] + 0.5
    picture = np.stack([x / 5, y / 5, np.zeros_like(x)], axis=2).astype(np.uint8)
    crop = Crop(np.array([480.0, 530.0]), size_px, angle)
    v, u = np.mgrid[:192, :192] + 0.5
    local = np.stack([u, v], axis=2) - 96
    place = crop.centre_px + local * (size_px / 192) @ crop.axes()
    shown = face_mesh.resampled(picture, crop, face_mesh.SIZE_PX).astype(float)[:, :, :2]
    # The ramp's steps of 5 px are rounded down.
    assert np.abs(shown + 0.5 - place / 5).max() < 1.2
    assert abs((shown + 0.5 - place / 5).mean()) < 0.06


def test_a_crop_beside_the_picture_is_its_edge_going_on():
    picture = np.full((50, 40, 3), 77, np.uint8)
    for centre in ((-500.0, -500.0), (20.0, 900.0)):
        for size in (30.0, 3000.0):
            crop = Crop(np.array(centre), size, 0.3)
            assert (face_mesh.resampled(picture, crop, face_mesh.SIZE_PX) == 77).all()


def test_the_crop_of_points_holds_them_all_with_a_quarter_to_spare():
    rng = np.random.default_rng(1)
    points = rng.uniform(100, 200, (468, 2))
    points[face_mesh.RIGHT_EYE], points[face_mesh.LEFT_EYE] = (120, 130), (180, 160)
    crop = face_mesh.crop_of_points(points)
    local = (points - crop.centre_px) @ crop.axes().T / crop.size_px
    assert np.isclose(np.abs(local).max(), 0.5 / face_mesh.SPARE)
    level = local[face_mesh.LEFT_EYE] - local[face_mesh.RIGHT_EYE]
    assert level[0] > 0
    assert np.isclose(level[1], 0)
