import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.rig import default_rig
from processing.frames.drafts import RED
from processing.frames.read import Frames
from processing.frames.window import Window
from processing.reconstruction.poses import PoseReport, in_pixels
from processing.reconstruction.small_views import (
    matched_times,
    of_cells,
    small_view,
    smaller_picture,
)

CAMERA = default_rig().scaled(0.01).cameras[0]
SHAPE = (CAMERA.height_px, CAMERA.width_px)
NAMES = ("full", "x+")


def windowed(rng: np.random.Generator) -> Frames:
    window = Window(5, 3, 31, 26)
    half = rng.uniform(-0.1, 1, (2, *window.shape, 3)).astype(np.float16)
    clipped = np.where(rng.random(window.shape) < 0.2, RED, 0).astype(np.uint8)
    return Frames(NAMES, half, 4.0, window, SHAPE, clipped)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([2, 4, 8]))
def test_small_pictures_are_plain_means(seed: int, times: int) -> None:
    rng = np.random.default_rng(seed)
    frames = windowed(rng)
    mask = rng.random(SHAPE) < 0.3
    normals = rng.normal(size=(*SHAPE, 3)).astype(np.float32)
    normals[rng.random(SHAPE) < 0.2] = np.nan
    found = small_view(CAMERA, frames, mask, normals, times)
    images, valid = frames.images.astype(float), frames.valid
    assert found.images.shape == (2, -(-SHAPE[0] // times), -(-SHAPE[1] // times), 3)
    for y in range(found.valid.shape[0]):
        for x in range(found.valid.shape[1]):
            cell = np.s_[y * times : (y + 1) * times, x * times : (x + 1) * times]
            usable = valid[cell]
            assert found.valid[y, x] == (2 * usable.sum() >= times * times)
            if found.valid[y, x]:
                plain = images[:, *cell][:, usable].mean(axis=1)
                np.testing.assert_allclose(found.images[:, y, x], plain, rtol=1e-5, atol=1e-6)
            else:
                assert (found.images[:, y, x] == 0).all()
            assert found.mask[y, x] == mask[cell].any()
            mean = np.nansum(normals[cell], axis=(0, 1))
            if np.linalg.norm(mean) > 0.2:
                mean /= np.linalg.norm(mean)
                np.testing.assert_allclose(found.normals[y, x], mean, atol=1e-4)


def test_a_point_keeps_its_place() -> None:
    frames = windowed(np.random.default_rng(0))
    empty = np.zeros(SHAPE, bool)
    found = small_view(CAMERA, frames, empty, np.zeros((*SHAPE, 3), np.float32), 4, ["x+"])
    points = np.array([[0.0, 0, 0], [40, 30, 20]])
    np.testing.assert_allclose(4 * found.camera.project(points)[0], CAMERA.project(points)[0])
    assert len(found.images) == 1
    assert not found.mask.any()
    assert not found.normals.any()


@pytest.mark.parametrize(
    ("rows", "times"), [(200, 1), (600, 1), (1504, 1), (1601, 2), (3200, 2), (3201, 4), (6016, 4)]
)
def test_large_pictures_are_made_smaller(rows: int, times: int) -> None:
    assert matched_times(rows, 1600) == times


def test_poses_are_checked_in_smaller_pictures_and_reported_in_whole_ones() -> None:
    picture = np.arange(35, dtype=np.uint8).reshape(5, 7)
    mask = picture != 8
    small, inside = smaller_picture(picture, mask, 2)
    assert small.tolist() == [[4, 6, 8], [18, 20, 22]]
    assert inside.tolist() == [[False, True, True], [True, True, True]]
    assert smaller_picture(picture, mask, 1)[0] is picture
    points = np.array([[10.0, -20, 30]])
    np.testing.assert_allclose(
        2 * of_cells(CAMERA, 2).project(points)[0], CAMERA.project(points)[0]
    )
    report = PoseReport(("a",), (9,), (0.5,), 2.0, (), ((0, 1, 0.25),), 3, 0.125, 50.0)
    whole = in_pixels(report, 2)
    assert (whole.residual_px, whole.limit_px, whole.track_residual_px) == ((1.0,), 4.0, 0.25)
    assert whole.pairs == ((0, 1, 0.5),)
    assert whole.spread_mm == 50.0
