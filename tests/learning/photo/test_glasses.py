"""Glasses are found by their frame, and a face without them is never touched."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from learning.photo.glasses import worn_before
from lightstage.rig import Camera

SIZE, FOCAL_PX, AWAY_MM = 480, 1500.0, 800.0
EYES_MM = np.array([[-31.0, 0.0], [31.0, 0.0]])


def camera_before() -> Camera:
    pose = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, AWAY_MM]])
    centre = SIZE / 2
    return Camera("c", "", "", SIZE, SIZE, FOCAL_PX, FOCAL_PX, centre, centre, (0.0,) * 5, pose)


def marks() -> np.ndarray:
    points = np.zeros((68, 3))
    points[36:42, :2], points[42:48, :2] = EYES_MM
    return points


def pixel(place_mm: tuple[float, float]) -> tuple[int, int]:
    """Where a place of the lenses' plane is."""
    scale = FOCAL_PX / (AWAY_MM - 12)
    return round(SIZE / 2 + scale * place_mm[0]), round(SIZE / 2 - scale * place_mm[1])


def face(seed: int) -> np.ndarray:
    """Skin with a gradient and grain, eyes, brows, bags and a crease over the nose."""
    rng = np.random.default_rng(seed)
    picture = np.full((SIZE, SIZE, 3), (0.5, 0.3, 0.22))
    picture *= np.linspace(0.6, 1.2, SIZE)[:, None]
    for side, (x, _) in zip((-1, 1), EYES_MM, strict=True):
        cv2.ellipse(picture, pixel((x, 0)), (26, 10), 0, 0, 360, (0.05, 0.04, 0.03), -1)
        ends = pixel((x - 18, 17 - 2 * side)), pixel((x + 18, 17 + 2 * side))
        cv2.line(picture, *ends, (0.06, 0.04, 0.03), 12)
        cv2.ellipse(picture, pixel((x, -2)), (32, 22), 0, 20, 160, (0.35, 0.2, 0.14), 3)
    cv2.line(picture, pixel((-7, 3)), pixel((7, 3)), (0.2, 0.1, 0.07), 4)
    return np.asarray(picture * np.exp(0.03 * rng.normal(size=picture.shape)), np.float32)


def with_glasses(picture: np.ndarray, dark: bool) -> np.ndarray:
    """The face behind round rims, a bridge and arms."""
    out, black = picture.copy(), (0.02, 0.02, 0.02)
    for side, (x, _) in zip((-1, 1), EYES_MM, strict=True):
        lens = pixel((side * 33, -4)), (48, 36), 0, 0, 360
        cv2.ellipse(out, *lens, black, -1 if dark else 5)
        cv2.line(out, pixel((side * 58, 0)), pixel((side * 80, 2)), black, 5)
        assert abs(x) < 33
    cv2.line(out, pixel((-8, 0)), pixel((8, 0)), black, 5)
    return out


@pytest.mark.parametrize("seed", range(4))
def test_a_face_without_glasses_is_not_touched(seed: int) -> None:
    assert worn_before(face(seed), marks(), camera_before()) is None


def test_a_clear_pair_hides_its_frame_and_not_the_eyes() -> None:
    bare = face(0)
    picture = with_glasses(bare, dark=False)
    found = worn_before(picture, marks(), camera_before())
    assert found is not None
    assert not found.dark
    frame = (picture != bare).any(axis=2)
    assert (found.hidden & frame).sum() > 0.97 * frame.sum()
    for eye in EYES_MM:
        column, row = pixel(tuple(eye))
        assert not found.hidden[row - 8 : row + 8, column - 20 : column + 20].any()


def test_dark_lenses_hide_all_that_is_behind_them() -> None:
    bare = face(1)
    picture = with_glasses(bare, dark=True)
    found = worn_before(picture, marks(), camera_before())
    assert found is not None
    assert found.dark
    column = np.abs(np.arange(SIZE) - SIZE / 2) < 100
    lenses = (picture != bare).any(axis=2) & column
    assert (found.hidden & lenses).sum() > 0.98 * lenses.sum()


def test_a_photograph_from_the_side_is_left_as_it_is() -> None:
    camera = camera_before()
    turn = np.radians(50)
    yaw = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    pose = np.column_stack([camera.cam_from_world[:, :3] @ yaw, camera.cam_from_world[:, 3]])
    aside = dataclasses.replace(camera, cam_from_world=pose)
    assert worn_before(with_glasses(face(2), dark=False), marks(), aside) is None
