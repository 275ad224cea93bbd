import dataclasses

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.errors import ReconstructionError
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.consistency import Points, consistent_points, smooth_normals
from processing.reconstruction.fusion import (
    alone_share,
    boundary_loops,
    compact,
    fuse,
    largest_component,
    oriented,
)
from processing.reconstruction.stage import reconstruct_views
from processing.reconstruction.stereo import focus_point, match_views, pick_sources
from processing.reconstruction.views import Level, View
from tests.processing import textured_ball
from tests.processing.textured_ball import RADIUS_MM

# A pixel is 1.4 mm wide here, seven times a demo's.
CONFIG = ReconstructConfig(cell_mm=3.0, trim_mm=5.0, agree_mm=1.5)
ONE_LOOK = dataclasses.replace(CONFIG, look_again=False)
"""Half the time, where a claim is one of the first look."""


def ball_views(count: int = 5, **kwargs: object) -> list[View]:
    rng = np.random.default_rng(5)
    return textured_ball.views_of(textured_ball.cameras(count), rng, **kwargs)[0]  # type: ignore[arg-type]


@dataclasses.dataclass(frozen=True)
class Matched:
    """What `match_views` finds of the ball."""

    views: list[View]
    level: Level
    depths: list[np.ndarray]
    costs: list[np.ndarray]


def surface_error_mm(vertices: np.ndarray) -> np.ndarray:
    return np.abs(np.linalg.norm(vertices, axis=1) - RADIUS_MM)


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return reconstruct_views(ball_views(), CONFIG)[0]


@pytest.fixture(scope="module")
def matched() -> Matched:
    views = ball_views()
    level, depths, costs = match_views(views, CONFIG)
    for array in (*depths, *costs):
        array.flags.writeable = False
    return Matched(views, level, depths, costs)


def test_depth_of_a_ball_is_exact_to_a_fraction_of_a_pixel(matched: Matched) -> None:
    points = consistent_points(matched.level, matched.depths, matched.costs, CONFIG)
    error = surface_error_mm(points.positions)
    assert len(points.positions) > 0.5 * sum(view.mask.sum() for view in matched.views)
    assert np.median(error) < 0.1
    assert np.percentile(error, 95) < 0.6
    facing = np.einsum("nk,nk->n", points.normals, points.positions / RADIUS_MM)
    assert np.median(facing) > 0.995


def test_narrow_patches_follow_a_nose() -> None:
    radius, front = 15.0, 80.0
    views, points = textured_ball.views_of(
        textured_ball.cameras(4),
        np.random.default_rng(5),
        balls=((RADIUS_MM, 0.0), (radius, front)),
    )
    errors = {}
    for patch in (1, 2):
        level, depths, _ = match_views(views, ReconstructConfig(finest_patch_radius_px=patch))
        off = []
        for index, depth in enumerate(depths):
            along = points[index] @ level.poses[index][2, :3] + level.poses[index][2, 3]
            nose = np.linalg.norm(points[index] - [0, 0, front], axis=2) < 1.3 * radius
            nose &= level.masks[index] & (depth > 0)
            assert nose.sum() > 400
            off.append(np.abs(1 / depth[nose] - along[nose]))
        errors[patch] = np.median(np.concatenate(off))
    assert errors[1] < 0.6 * errors[2]


def test_mesh_of_a_ball_lies_on_it_and_faces_outward(ball: Mesh) -> None:
    error = surface_error_mm(ball.vertices)
    assert np.median(error) < 0.1
    assert np.percentile(error, 95) < 0.6
    normals = vertex_normals(ball.vertices, ball.faces)
    assert (np.einsum("nk,nk->n", normals, ball.vertices) > 0).mean() > 0.995


def test_mesh_of_a_ball_is_whole_in_front_and_absent_behind(ball: Mesh) -> None:
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions *= RADIUS_MM / np.linalg.norm(directions, axis=1, keepdims=True)
    gap = cKDTree(ball.vertices).query(directions)[0]
    front = directions[:, 2] > 0.6 * RADIUS_MM
    assert (gap[front] < 4).mean() > 0.99
    assert (gap[directions[:, 2] < -0.6 * RADIUS_MM] > 4).all()
    assert boundary_loops(ball).outline_mm > 2 * np.pi * 0.6 * RADIUS_MM


def test_a_black_view_and_a_camera_that_looks_away_do_no_harm() -> None:
    cams = textured_ball.cameras(5)
    cams[4] = textured_ball.turned_away(cams[4])
    views, _ = textured_ball.views_of(cams, np.random.default_rng(5), black=("cam5",))
    assert not views[3].mask.any()
    assert not views[4].mask.any()
    mesh, good = (reconstruct_views(some, ONE_LOOK)[0] for some in (views, views[:3]))
    assert np.median(surface_error_mm(mesh.vertices)) < 0.1
    assert len(mesh.vertices) > 0.9 * len(good.vertices)


def test_two_equal_cameras_are_not_matched_with_each_other() -> None:
    cams = textured_ball.cameras(3)
    cams.append(dataclasses.replace(cams[0], id="again"))
    chosen = pick_sources(cams, [True] * 4, CONFIG)
    assert 3 not in chosen[0]
    assert 0 not in chosen[3]
    views, _ = textured_ball.views_of(cams, np.random.default_rng(5))
    mesh = reconstruct_views(views, ONE_LOOK)[0]
    assert np.median(surface_error_mm(mesh.vertices)) < 0.1


def test_fewer_than_two_views_are_refused() -> None:
    with pytest.raises(ReconstructionError, match=r"something to see in 1 view,.* turned away\?"):
        reconstruct_views(ball_views(2, black=("cam1",)), CONFIG)
    with pytest.raises(ReconstructionError, match=r"One camera makes no mesh: .* --mesh, or take"):
        reconstruct_views(ball_views(1), CONFIG)
    cams = textured_ball.cameras(1)
    twice = [cams[0], dataclasses.replace(cams[0], id="again")]
    views, _ = textured_ball.views_of(twice, np.random.default_rng(5))
    with pytest.raises(ReconstructionError, match="0 points"):
        reconstruct_views(views, CONFIG)


def test_clipped_pixels_are_passed_over() -> None:
    cams = textured_ball.cameras(3)
    views, _ = textured_ball.views_of(cams, np.random.default_rng(5))
    for view in views:
        view.textures[120:150, 80:100] = np.nan
    mesh = reconstruct_views(views, ONE_LOOK)[0]
    assert np.isfinite(mesh.vertices).all()
    assert np.median(surface_error_mm(mesh.vertices)) < 0.1


def test_lens_distortion_is_undone() -> None:
    bent = [
        dataclasses.replace(camera, dist=(0.15, -0.05, 0.001, -0.002, 0.0))
        for camera in textured_ball.cameras(3)
    ]
    views, _ = textured_ball.views_of(bent, np.random.default_rng(5))
    assert not any(any(view.camera.dist) for view in views)
    level, depths, costs = match_views(views, CONFIG)
    points = consistent_points(level, depths, costs, CONFIG)
    assert np.median(surface_error_mm(points.positions)) < 0.12


def test_cameras_look_at_the_head() -> None:
    np.testing.assert_allclose(focus_point(textured_ball.cameras(9)), 0, atol=1e-6)


def test_normals_follow_the_points_not_a_biased_guide() -> None:
    x, y = np.meshgrid(np.arange(30) * 0.6, np.arange(20) * 0.6)
    points = np.stack([x, y, 0.3 * x], axis=-1).astype(np.float32)
    true = np.array([-0.3, 0, 1]) / np.hypot(0.3, 1)
    guide = np.broadcast_to(np.array([0, 0, 1], np.float32), points.shape).copy()
    found = smooth_normals(points, guide, 3, 3.0)
    assert np.degrees(np.arccos(np.clip(found @ true, -1, 1))).max() < 2.0
    guide[5, 5], points[8, 8] = 0, np.nan
    assert np.isnan(smooth_normals(points, guide, 3, 3.0)[[5, 8], [5, 8]]).all()


def test_largest_component_and_loops_of_a_grid_with_a_hole() -> None:
    side = np.arange(11)
    x, y = np.meshgrid(side, side)
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(float)
    here = (side[:-1, None] * 11 + side[None, :-1]).ravel()
    here = here[~np.isin(here, [48, 49, 59, 60])]
    quads = np.stack([here, here + 1, here + 12, here + 11], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    stray = np.array([[121, 122, 123]], np.int32)
    vertices = np.concatenate([vertices, np.eye(3) + 50])
    kept = largest_component(np.concatenate([faces, stray]), len(vertices))
    assert len(kept) == len(faces)
    mesh = compact(vertices, kept)
    holes = boundary_loops(mesh)
    assert holes.outline_mm == pytest.approx(40)
    assert holes.lengths_mm == pytest.approx((8.0,))
    up = np.broadcast_to([0.0, 0, 1], mesh.vertices.shape)
    for candidate in (mesh, Mesh(mesh.vertices, mesh.faces[:, ::-1].copy())):
        turned = oriented(candidate, mesh.vertices, up)
        assert (vertex_normals(turned.vertices, turned.faces)[:, 2] > 0.99).all()


def test_the_share_of_the_surface_that_rests_on_one_view_is_reported() -> None:
    x, y = np.meshgrid(np.arange(40.0), np.arange(40.0))
    places = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    mesh = Mesh(places, np.zeros((0, 3), np.int32))
    for end in (0, 10, 20):
        views = np.where(places[:, 0] < end, 0, 2)
        points = Points(places, places, views, np.zeros(len(places), int))
        assert alone_share(mesh, points) == pytest.approx(end / 40, abs=0.05)


def test_too_few_points_are_refused() -> None:
    few = Points(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3, int), np.zeros(3, int))
    with pytest.raises(ReconstructionError, match="3 points"):
        fuse(few, CONFIG)


def test_depths_at_rest_are_passed_over_and_the_surface_stays(matched: Matched) -> None:
    """The same ball matched with and without the skip: nearer to each other than to the truth."""
    depths, every = matched.depths, dataclasses.replace(CONFIG, still_px=0.0)
    _, all_tried, all_costs = match_views(matched.views, every)
    apart, errors = [], []
    for config, found, cost in ((CONFIG, depths, matched.costs), (every, all_tried, all_costs)):
        points = consistent_points(matched.level, found, cost, config)
        errors.append(float(np.median(surface_error_mm(points.positions))))
    for one, other in zip(depths, all_tried, strict=True):
        both = (one > 0) & (other > 0)
        apart.append(np.abs(1 / one[both] - 1 / other[both]))
        assert ((one > 0) != (other > 0)).mean() < 0.002
    gap = np.concatenate(apart)
    assert errors[0] < 1.05 * errors[1] + 1e-3
    assert np.median(gap) < 0.3 * errors[1]
    assert np.percentile(gap, 95) < 0.4
