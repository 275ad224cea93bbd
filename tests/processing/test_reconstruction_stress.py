"""What a stage meets on a bad day: a right surface, a smaller one, or a clear refusal."""

import dataclasses
from collections.abc import Callable

import cv2
import numba
import numpy as np
import pytest

from lightstage.rig import Camera
from processing.errors import ReconstructionError
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.consistency import Points, consistent_points
from processing.reconstruction.stage import reconstruct_views
from processing.reconstruction.stereo import match_views
from processing.reconstruction.views import View, common_basis, make_view
from tests.processing import textured_ball
from tests.processing.textured_ball import RADIUS_MM, shoot

# A pixel is 1.8 mm wide here.
CONFIG = ReconstructConfig(cell_mm=4.0, trim_mm=6.0, agree_mm=1.5, relief_mm=4.0, bias_mm=6.0)
CAMERAS = textured_ball.cameras(4, 0.035)

Shot = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Pictures (P, h, w, 3), foreground and normals of one camera."""


def views_of(
    cameras: list[Camera], change: Callable[[int, Shot], Shot] | None = None
) -> list[View]:
    rng = np.random.default_rng(5)
    shots = [shoot(camera, rng)[:3] for camera in cameras]
    if change is not None:
        shots = [change(k, shot) for k, shot in enumerate(shots)]
    basis = common_basis([s[0] for s in shots], [s[1] for s in shots])
    return [
        make_view(camera, s[0], np.isfinite(s[0]).all(axis=(0, 3)), s[1], s[2], basis)
        for camera, s in zip(cameras, shots, strict=True)
    ]


def points_of(views: list[View]) -> Points:
    return consistent_points(*match_views(views, CONFIG), CONFIG)


def error_mm(points: Points, centre: float | np.ndarray = 0.0) -> np.ndarray:
    return np.abs(np.linalg.norm(points.positions - centre, axis=1) - RADIUS_MM)


@pytest.fixture(scope="module")
def undisturbed() -> Points:
    return points_of(views_of(CAMERAS))


def right(points: Points, undisturbed: Points, share: float = 0.9) -> bool:
    error = error_mm(points)
    return (
        len(points.positions) > share * len(undisturbed.positions)
        and float(np.median(error)) < 0.2
        and float(np.percentile(error, 95)) < 1.2
    )


def test_nothing_amiss(undisturbed: Points) -> None:
    assert right(undisturbed, undisturbed)


def test_a_view_of_another_size(undisturbed: Points) -> None:
    others = [*CAMERAS[:1], textured_ball.cameras(2, 0.025)[1], *CAMERAS[2:]]
    assert right(points_of(views_of(others)), undisturbed, 0.8)


def test_a_head_half_out_of_a_picture(undisturbed: Points) -> None:
    moved = dataclasses.replace(CAMERAS[1], cx_px=CAMERAS[1].cx_px - 60)
    points = points_of(views_of([CAMERAS[0], moved, *CAMERAS[2:]]))
    assert right(points, undisturbed, 0.7)


def test_one_view_out_of_focus(undisturbed: Points) -> None:
    def blurred(k: int, shot: Shot) -> Shot:
        if k != 1:
            return shot
        return np.stack([cv2.GaussianBlur(p, (0, 0), 3.0) for p in shot[0]]), *shot[1:]

    assert right(points_of(views_of(CAMERAS, blurred)), undisturbed, 0.6)


def test_highlights_that_wander_with_the_view(undisturbed: Points) -> None:
    def shining(k: int, shot: Shot) -> Shot:
        pictures, mask, normals = shot
        half = CAMERAS[k].centre_mm / np.linalg.norm(CAMERAS[k].centre_mm) + textured_ball.LIGHTS
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        lobe = np.clip(normals @ half.T, 0, None) ** 60 * mask[..., None]
        return (
            (pictures + 0.3 * lobe.transpose(2, 0, 1)[..., None]).astype(np.float32),
            mask,
            normals,
        )

    points = points_of(views_of(CAMERAS, shining))
    assert len(points.positions) > 0.6 * len(undisturbed.positions)
    assert np.median(error_mm(points)) < 0.4


def test_a_head_that_swayed_by_three_mm_before_one_shot(undisturbed: Points) -> None:
    # The third camera photographs it 3 mm aside: its own pose says otherwise.
    pose = CAMERAS[2].cam_from_world.copy()
    pose[:, 3] += pose[:, :3] @ np.array([3.0, 0.0, 0.0])
    swayed = dataclasses.replace(CAMERAS[2], cam_from_world=pose)
    views = views_of([*CAMERAS[:2], swayed, CAMERAS[3]])
    views[2] = dataclasses.replace(views[2], camera=CAMERAS[2])
    points = points_of(views)
    error = error_mm(points)
    assert len(points.positions) > 0.3 * len(undisturbed.positions)
    # What stands is what the others agree on, or lies between the two places of the head.
    assert np.median(error) < 0.7
    assert np.percentile(error, 99) < 3.5


def test_a_head_without_any_texture() -> None:
    def plaster(k: int, shot: Shot) -> Shot:
        light = np.clip(shot[2] @ textured_ball.LIGHTS.T, 0, None) * shot[1][..., None]
        plain = 0.5 * light.transpose(2, 0, 1)[..., None] * np.ones(3)
        noise = np.random.default_rng(k).normal(0, 0.001, plain.shape)
        return (plain + noise).astype(np.float32), *shot[1:]

    # Shading under several lights is a texture too: the five pictures tell the surface apart.
    error = error_mm(points_of(views_of(CAMERAS, plaster)))
    assert np.median(error) < 0.6


def test_all_pictures_black() -> None:
    views = views_of(CAMERAS, lambda _, shot: (0 * shot[0], *shot[1:]))
    with pytest.raises(ReconstructionError):
        reconstruct_views(views, CONFIG)


def test_a_stage_a_hundred_metres_from_the_origin(undisturbed: Points) -> None:
    shift = np.array([1e5, -1e5, 1e5])
    views = []
    for view in views_of(CAMERAS):
        pose = view.camera.cam_from_world.copy()
        pose[:, 3] -= pose[:, :3] @ shift
        views.append(
            dataclasses.replace(view, camera=dataclasses.replace(view.camera, cam_from_world=pose))
        )
    points = points_of(views)
    assert len(points.positions) == pytest.approx(len(undisturbed.positions), rel=0.02)
    # World coordinates are single precision: .008 mm there.
    assert np.median(error_mm(points, shift)) < np.median(error_mm(undisturbed)) + 0.02


def test_points_are_the_same_with_one_and_two_threads(undisturbed: Points) -> None:
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = points_of(views_of(CAMERAS))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(alone.positions, undisturbed.positions)
    np.testing.assert_array_equal(alone.normals, undisturbed.normals)
