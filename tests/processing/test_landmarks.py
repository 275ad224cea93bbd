import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.rays import MeshRays
from processing.registration.landmarks import UNDISTORT_ROUNDS, nearest_point, triangulate
from tests.processing.shapes import camera, ellipsoid

CAMERAS = {f"cam{i}": camera(f"cam{i}", a, dist=True) for i, a in enumerate((0, -40, 40, 70))}


def clicks(points):
    return {name: cam.project(points)[0] for name, cam in CAMERAS.items()}


def some_points(count=68, seed=0):
    return np.random.default_rng(seed).uniform(-60, 60, size=(count, 3))


def test_points_are_recovered_through_distortion():
    truth = some_points()
    found = triangulate(clicks(truth), CAMERAS, agree_mm=1.0)
    assert np.abs(found.points_mm - truth).max() < 1e-4
    assert (found.views == 4).all()
    assert found.outliers == ()


def test_click_noise_shrinks_with_the_number_of_views():
    truth = some_points(300)
    rng = np.random.default_rng(1)
    noisy = {name: p + 0.5 * rng.normal(size=p.shape) for name, p in clicks(truth).items()}
    error = {}
    for count in (2, 4):
        names = list(CAMERAS)[:count]
        found = triangulate({n: noisy[n] for n in names}, CAMERAS, agree_mm=5.0)
        error[count] = np.linalg.norm(found.points_mm - truth, axis=1).mean()
    # A pixel is 0.8 mm wide there.
    assert error[4] < 0.5 < error[2]


def test_wrong_clicks_are_named_and_left_out():
    truth = some_points()
    points_px = clicks(truth)
    points_px["cam1"][7] += [40, 0]
    points_px["cam2"][7] += [0, -25]
    points_px["cam3"][30] += [15, 15]
    found = triangulate(points_px, CAMERAS, agree_mm=2.0)
    named = {(o.camera, o.landmark_idx) for o in found.outliers}
    assert named == {("cam1", 7), ("cam2", 7), ("cam3", 30)}
    assert np.abs(found.points_mm - truth).max() < 1e-3
    assert "cam3 landmark 30" in " ".join(str(o) for o in found.outliers)
    assert all(o.error_mm > 2.0 for o in found.outliers)


def test_two_views_that_disagree_give_no_point():
    truth = some_points()
    points_px = {name: p for name, p in clicks(truth).items() if name in ("cam0", "cam1")}
    points_px["cam1"][5] += [0, 30]
    found = triangulate(points_px, CAMERAS, agree_mm=2.0)
    assert np.isnan(found.points_mm[5]).all()
    assert {o.landmark_idx for o in found.outliers} == {5}
    assert len(found.outliers) == 2


def test_hidden_landmarks_stay_unknown_and_a_single_view_uses_the_surface():
    mesh = ellipsoid()
    rays = MeshRays(mesh.vertices, mesh.triangles())
    truth = mesh.vertices[mesh.vertices[:, 2] > 50][:68]
    points_px = clicks(truth)
    for name in ("cam1", "cam2", "cam3"):
        points_px[name][:10] = np.nan
    points_px["cam0"][3] = np.nan
    with_surface = triangulate(points_px, CAMERAS, agree_mm=2.0, surface=rays)
    without = triangulate(points_px, CAMERAS, agree_mm=2.0)
    assert np.isnan(with_surface.points_mm[3]).all()
    assert with_surface.views[3] == 0
    known = [i for i in range(10) if i != 3]
    assert np.abs(with_surface.points_mm[known] - truth[known]).max() < 0.02
    assert np.isnan(without.points_mm[known]).all()


def test_cameras_that_the_rig_lacks_are_passed_over():
    found = triangulate({"other": np.zeros((68, 2))}, CAMERAS, agree_mm=1.0)
    assert found.points_mm.shape[1:] == (3,)
    assert not np.isfinite(found.points_mm).any()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-3, 1.0, 1e3, 1e6]))
def test_nearest_point_matches_a_plain_least_squares(seed, scale):
    rng = np.random.default_rng(seed)
    origins = scale * rng.normal(size=(4, 3))
    directions = rng.normal(size=(4, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = nearest_point(origins, directions)
    rows, right = [], []
    for o, d in zip(origins, directions, strict=True):
        across = np.eye(3) - np.outer(d, d)
        rows.append(across)
        right.append(across @ o)
    plain = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    assert found is not None
    assert np.allclose(found, plain, atol=1e-6 * scale)


def test_parallel_rays_meet_nowhere():
    directions = np.array([[0.0, 0, 1], [0.0, 0, 1]])
    assert nearest_point(np.eye(3)[:2], directions) is None


@pytest.mark.parametrize("place", [(0.5, 0.5), (121.3, 163.9), (239.5, 329.5), (-20.0, 400.0)])
def test_rays_through_pixels_undo_projection(place):
    cam = CAMERAS["cam1"]
    direction = cam.rays_through(*np.array([place]).T, UNDISTORT_ROUNDS)
    back, _ = cam.project(cam.centre_mm + 900 * direction)
    assert np.allclose(back, [place], atol=1e-5)
