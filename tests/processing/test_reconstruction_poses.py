import dataclasses

import numpy as np
import pytest

from lightstage.rig import Camera
from processing.errors import PoseError
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.matches import _undistorted, match_features
from processing.reconstruction.poses import (
    PairMatches,
    PoseReport,
    against_rig,
    blame,
    check_poses,
    drifted,
    raise_when_off,
    tone_mapped,
    unchecked,
)
from tests.processing import textured_ball

CONFIG = ReconstructConfig()
STAGE_MM = 1250.0


@pytest.fixture(scope="module")
def shots() -> tuple[list[Camera], list[np.ndarray], list[np.ndarray]]:
    cams = textured_ball.cameras(5, factor=0.07)
    rng = np.random.default_rng(1)
    pictures, masks = [], []
    for camera in cams:
        images, mask, _, _ = textured_ball.shoot(camera, rng)
        pictures.append(tone_mapped(images[0], mask))
        masks.append(mask)
    return cams, pictures, masks


def test_right_poses_pass_with_a_small_residual(
    shots: tuple[list[Camera], list[np.ndarray], list[np.ndarray]],
) -> None:
    cams, pictures, masks = shots
    report = check_poses(pictures, masks, cams, CONFIG)
    raise_when_off(report, STAGE_MM)
    assert report.off == ()
    assert max(report.residual_px) < 0.5
    assert min(report.matches) >= CONFIG.min_matches
    assert report.tracks > 100
    assert 10 < report.spread_mm < textured_ball.RADIUS_MM


def test_places_in_a_bent_picture_become_those_of_a_straight_one() -> None:
    straight = textured_ball.cameras(1, factor=0.07)[0]
    bent = dataclasses.replace(straight, dist=(0.3, -0.1, 0.01, -0.02, 0.05))
    points = np.random.default_rng(0).uniform(-90, 90, (200, 3))
    seen, known = bent.project(points)[0], straight.project(points)[0]
    assert np.abs(seen - known).max() > 0.5
    np.testing.assert_allclose(_undistorted(seen, bent), known, atol=0.01)
    np.testing.assert_array_equal(_undistorted(seen, straight), seen)


def test_swapped_cameras_are_named(
    shots: tuple[list[Camera], list[np.ndarray], list[np.ndarray]],
) -> None:
    cams, pictures, masks = shots
    swapped = [pictures[0], pictures[3], pictures[2], pictures[1], pictures[4]]
    swapped_masks = [masks[0], masks[3], masks[2], masks[1], masks[4]]
    report = check_poses(swapped, swapped_masks, cams, CONFIG)
    with pytest.raises(PoseError, match=r"cam[15] \(.*cam[15] \("):
        raise_when_off(report, STAGE_MM)
    assert {report.camera_ids[k] for k in report.off} == {"cam1", "cam5"}


def test_a_camera_that_was_knocked_is_named(
    shots: tuple[list[Camera], list[np.ndarray], list[np.ndarray]],
) -> None:
    cams, pictures, masks = shots
    pose = cams[2].cam_from_world.copy()
    angle = np.radians(2.0)
    roll = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    knocked = list(cams)
    knocked[2] = dataclasses.replace(cams[2], cam_from_world=roll @ pose)
    knocked[2].cam_from_world[1, 3] += 25.0
    report = check_poses(pictures, masks, knocked, CONFIG)
    assert [report.camera_ids[k] for k in report.off] == [cams[2].id]


def test_a_rig_in_metres_is_refused(
    shots: tuple[list[Camera], list[np.ndarray], list[np.ndarray]],
) -> None:
    cams, pictures, masks = shots
    metres = []
    for camera in cams:
        pose = camera.cam_from_world.copy()
        pose[:, 3] /= 1000
        metres.append(dataclasses.replace(camera, cam_from_world=pose))
    with pytest.raises(PoseError, match="positions in mm"):
        raise_when_off(check_poses(pictures, masks, metres, CONFIG), STAGE_MM)


def test_black_pictures_are_not_judged() -> None:
    cams = textured_ball.cameras(3)
    shape = (cams[0].height_px, cams[0].width_px)
    nothing = tone_mapped(np.zeros((*shape, 3)), np.zeros(shape, bool))
    report = check_poses([nothing] * 3, [np.zeros(shape, bool)] * 3, cams, CONFIG)
    raise_when_off(report, STAGE_MM)
    assert report.matches == (0, 0, 0)
    assert np.isnan(report.residual_px).all()


def test_residual_of_true_matches_is_zero_and_of_shifted_ones_the_shift() -> None:
    cams = textured_ball.cameras(2)
    rng = np.random.default_rng(2)
    points = rng.uniform(-60, 60, (50, 3))
    pixels = np.stack([camera.project(points)[0] for camera in cams], axis=1)
    np.testing.assert_allclose(against_rig(*cams, pixels), 0, atol=1e-8)
    # The baseline is horizontal, so epipolar lines of the middle rows are nearly so.
    pixels[:, 1, 1] += 1.0
    np.testing.assert_allclose(against_rig(*cams, pixels), np.sqrt(0.5), rtol=0.05)
    assert np.isinf(against_rig(cams[0], cams[0], pixels)).all()


def test_blame_takes_one_out_before_it_judges_the_others() -> None:
    def pair(first: int, second: int, residual: float) -> PairMatches:
        return PairMatches(first, second, np.zeros((30, 2, 2)), np.full(30, residual))

    pairs = [pair(a, b, 20.0 if 2 in (a, b) else 0.3) for a in range(4) for b in range(a + 1, 4)]
    residuals, off = blame(pairs, 4, 2.0, 20)
    assert off == [2]
    np.testing.assert_allclose(residuals, [0.3, 0.3, 20.0, 0.3])
    assert blame([pair(0, 1, 9.0)], 3, 2.0, 40)[1] == []


def test_blame_spares_a_camera_that_only_those_that_are_off_see() -> None:
    def pair(first: int, second: int, residual: float) -> PairMatches:
        return PairMatches(first, second, np.zeros((30, 2, 2)), np.full(30, residual))

    # 1 and 3 are off; 4 matches with nobody else, and misses by the most.
    pairs = [pair(1, 4, 30.0), pair(3, 4, 30.0), pair(1, 3, 9.0), pair(0, 2, 0.3)]
    pairs += [pair(a, b, 9.0) for a in (0, 2) for b in (1, 3)]
    residuals, off = blame(pairs, 5, 2.0, 20)
    assert set(off) == {1, 3}
    assert residuals[0] == residuals[2] == pytest.approx(0.3)


def test_features_match_only_mutually_and_distinctly() -> None:
    rng = np.random.default_rng(4)
    first = rng.normal(size=(40, 128)).astype(np.float32)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    order = rng.permutation(40)
    second = first[order]
    matches = match_features(first, second)
    assert len(matches) == 40
    np.testing.assert_array_equal(order[matches[:, 1]], matches[:, 0])
    assert len(match_features(first, np.repeat(first[:1], 5, axis=0))) == 0
    assert len(match_features(first[:1], second)) == 0


def test_the_message_names_residual_and_limit() -> None:
    report = PoseReport(
        ("cam0", "cam1"), (99, 99), (0.2, 8.5), 2.0, (1,), ((0, 1, 8.5),), 0, np.nan, np.nan
    )
    with pytest.raises(PoseError, match=r"cam1 \(8.5 px, with cam0 8.5 px\).*2.0 px"):
        raise_when_off(report, STAGE_MM)


def test_a_camera_that_drifted_a_little_is_warned_of_and_nothing_is_moved() -> None:
    nan = float("nan")
    report = PoseReport(
        ("a", "b", "c", "d"), (90,) * 4, (0.2, 1.4, 9.0, nan), 4.0, (2,), (), 50, 0.3, 60.0
    )
    text = drifted(report, CONFIG)
    assert len(text) == 1
    assert text[0].startswith("the matches of b miss the rig by 1.40 px (median, above 1.20)")


def test_cameras_with_too_few_matches_are_named_in_one_warning_with_what_it_takes() -> None:
    nan = float("nan")
    report = PoseReport(("a", "b", "c"), (17, 90, 1), (nan, 0.2, nan), 4.0, (), (), 50, 0.3, 60.0)
    (text,) = unchecked(report, CONFIG)
    assert "the right pose of a (17 matches), c (1 match): that takes 20 matches" in text
    alone = dataclasses.replace(report, residual_px=(0.1, 0.2, 0.3))
    assert unchecked(alone, CONFIG) == []
