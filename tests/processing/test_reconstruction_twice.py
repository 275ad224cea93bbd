import dataclasses

import numpy as np
import open3d
import pytest

from lightstage.formats.mesh import Mesh
from processing.lighting.interface import skin_interface
from processing.lighting.lights import Shadows, irradiance_vectors
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.consistency import Points
from processing.reconstruction.second_depth import Sighted, look_again, rays_of, sighted
from processing.reconstruction.shading import mended_normals
from processing.reconstruction.stereo import match_views, sources_of
from processing.reconstruction.two_passes import reconstruct_in_two_rounds, spacing_mm
from processing.reconstruction.views import Level, View, finest_level, halved, make_view
from tests.processing import lit_ball, textured_ball
from tests.processing.textured_ball import RADIUS_MM

CONFIG = ReconstructConfig(
    cell_mm=3.0, trim_mm=5.0, agree_mm=1.5, settle_mm=1.5, split_settle_mm=1.0
)
LIGHTS = lit_ball.lights_of_rig(lit_ball.small_rig())


def ball(radius_mm: float = RADIUS_MM, resolution: int = 80) -> Mesh:
    shape = open3d.geometry.TriangleMesh.create_sphere(radius_mm, resolution)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.triangles).astype(np.int32))


@pytest.fixture(scope="module")
def views() -> list[View]:
    return textured_ball.views_of(textured_ball.cameras(3), np.random.default_rng(5))[0]


@pytest.fixture(scope="module")
def fine(views: list[View]) -> Level:
    return finest_level(views)


def seen_by(level: Level, mesh: Mesh) -> list[Sighted]:
    return sighted(level, mesh, *rays_of(mesh))


def looked(
    views: list[View], fine: Level, seen: list[Sighted], unsure: bool = False
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    asked = [np.full(sight.inverse_depth.shape, unsure) for sight in seen]
    return look_again(fine, seen, sources_of(views, CONFIG), asked, CONFIG)


def depth_error(level: Level, index: int, inverse_depth: np.ndarray) -> np.ndarray:
    """How far points lie off the ball, mm, where there is depth and the ball is not grazed."""
    (fx, fy, cx, cy), pose = level.lenses[index], level.poses[index]
    row, column = np.nonzero(inverse_depth)
    z = 1 / inverse_depth[row, column]
    local = np.stack([(column + 0.5 - cx) / fx * z, (row + 0.5 - cy) / fy * z, z], axis=1)
    points = (local - pose[:, 3]) @ pose[:, :3]
    centre = -pose[:, :3].T @ pose[:, 3]
    facing = points @ centre > 0.5 * RADIUS_MM * np.linalg.norm(centre)
    return np.linalg.norm(points, axis=1)[facing] - RADIUS_MM


def test_a_mesh_is_seen_where_it_is(fine: Level) -> None:
    for index, sight in enumerate(seen_by(fine, ball())):
        assert np.abs(depth_error(fine, index, sight.inverse_depth)).max() < 0.1
        length = np.linalg.norm(sight.normals[sight.rows, sight.columns], axis=1)
        np.testing.assert_allclose(length, 1, atol=1e-4)


@pytest.mark.parametrize("times", [1, 2])
def test_the_second_look_finds_the_surface(views: list[View], fine: Level, times: int) -> None:
    level = fine if times == 1 else halved(fine)
    seen = seen_by(level, ball(RADIUS_MM - 0.3))
    depths, costs = looked(views, fine, seen)
    for index in range(len(views)):
        before = depth_error(level, index, seen[index].inverse_depth)
        kept = np.where(costs[index] < CONFIG.max_cost, depths[index], 0)
        after = depth_error(level, index, kept)
        assert len(after) > 0.9 * len(before)
        assert abs(np.median(after)) < 0.05
        assert np.median(np.abs(after)) < 0.5 * np.median(np.abs(before))


@pytest.mark.parametrize("times", [1, 2])
def test_where_the_mesh_is_unsure_the_second_look_searches(
    views: list[View], fine: Level, times: int
) -> None:
    """A mesh two pixels off: too far for a parabola, near enough for a search."""
    level = fine if times == 1 else halved(fine)
    seen = seen_by(level, ball(RADIUS_MM - 4.0))
    share = []
    for unsure in (False, True):
        depths, _ = looked(views, fine, seen, unsure)
        off = np.concatenate(
            [np.abs(depth_error(level, index, depth)) for index, depth in enumerate(depths)]
        )
        share.append(float((off < 0.5).mean()))
    assert share[0] < 0.2
    assert share[1] > 0.6


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_pixel_is_as_wide_as_its_ray_is_long(fine: Level, scale: float) -> None:
    centre = -fine.poses[1][:, :3].T @ fine.poses[1][:, 3]
    toward = np.array([[0.0, 0, 1]])
    places = centre + scale * toward
    points = Points(places, toward, np.ones(1, int), np.ones(1, int))
    assert spacing_mm(fine, points) == pytest.approx(scale / fine.lenses[1, 0], rel=1e-6)
    none = Points(places[:0], toward[:0], np.ones(0, int), np.ones(0, int))
    assert spacing_mm(fine, none) == 0


def test_nothing_seen_gives_no_depth(views: list[View], fine: Level) -> None:
    near = ball(resolution=10)
    far = Mesh(near.vertices + np.array([1e4, 0, 0]), near.faces)
    depths, costs = looked(views, fine, seen_by(fine, far), unsure=True)
    assert not any(depth.any() for depth in depths)
    assert all((cost == 2).all() for cost in costs)


def with_plate() -> Mesh:
    """A ball, and above its front a plate that keeps light from it and is not in the picture."""
    front, plate = ball(), open3d.geometry.TriangleMesh.create_box(70, 4, 60)
    vertices = np.asarray(plate.vertices) + np.array([-35, 50, 78])
    faces = np.asarray(plate.triangles) + len(front.vertices)
    return Mesh(
        np.concatenate([front.vertices, vertices]),
        np.concatenate([front.faces, faces]).astype(np.int32),
    )


def degrees(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    cosine = np.einsum("...k,...k->...", one, two)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@pytest.fixture(scope="module")
def lit(fine: Level) -> tuple[Mesh, list[Sighted], list[np.ndarray], list[np.ndarray]]:
    """Mesh, what is seen of it, signals (h, w, P) under its shadows, true normals of the pixels."""
    mesh = with_plate()
    rays, normals = rays_of(mesh)
    seen, signals, true = sighted(fine, mesh, rays, normals), [], []
    for sight in seen:
        at = sight.rows, sight.columns
        n = sight.normals[at].astype(float)
        corners = mesh.faces[sight.hits.face]
        points = np.einsum("nck,nc->nk", mesh.vertices[corners], sight.hits.barycentric)
        own = rays.visible(points, n, LIGHTS.position_mm).astype(np.uint8)
        each = np.repeat(np.arange(len(n), dtype=np.int32)[:, None], 3, axis=1)
        shadows = Shadows(each, np.full((len(n), 3), 1 / 3, np.float32), own)
        vectors = irradiance_vectors(LIGHTS, points, n, shadows, skin_interface())
        signal = np.full((*sight.inverse_depth.shape, vectors.shape[1]), np.nan, np.float32)
        signal[at] = 0.3 * np.einsum("npk,nk->np", vectors, n)
        signals.append(signal)
        true.append(n)
    return mesh, seen, signals, true


def test_normals_in_the_shade_are_mended(
    views: list[View],
    fine: Level,
    lit: tuple[Mesh, list[Sighted], list[np.ndarray], list[np.ndarray]],
) -> None:
    mesh, seen, signals, true = lit
    shown = [dataclasses.replace(v, signal=s) for v, s in zip(views, signals, strict=True)]
    smooth = ball()
    unshaded = seen_by(fine, smooth)
    bare = mended_normals(fine, 1, shown, unshaded, smooth, *rays_of(smooth), LIGHTS)
    mended = mended_normals(fine, 1, shown, seen, mesh, *rays_of(mesh), LIGHTS)
    assert bare is not None
    assert mended is not None
    for index, sight in enumerate(seen):
        at = sight.rows, sight.columns
        off = [degrees(n[index][at], true[index]) for n in (bare, mended)]
        shaded = off[0] > 5
        assert shaded.sum() > 100
        assert np.median(off[1][shaded]) < 0.25 * np.median(off[0][shaded])
        assert np.median(off[1]) < 0.5


def test_pixels_without_a_signal_keep_their_normals(
    views: list[View],
    fine: Level,
    lit: tuple[Mesh, list[Sighted], list[np.ndarray], list[np.ndarray]],
) -> None:
    mesh, seen, signals, _ = lit
    hidden = [np.where(np.arange(s.shape[1])[None, :, None] < 90, np.nan, s) for s in signals]
    shown = [dataclasses.replace(v, signal=s) for v, s in zip(views, hidden, strict=True)]
    shown[1] = dataclasses.replace(views[1], signal=None)
    mended = mended_normals(fine, 1, shown, seen, mesh, *rays_of(mesh), LIGHTS)
    assert mended is not None
    np.testing.assert_array_equal(mended[0][:, :90], fine.normals[0][:, :90])
    np.testing.assert_array_equal(mended[1], fine.normals[1])
    assert np.abs(mended[2][:, 90:] - fine.normals[2][:, 90:]).max() > 0.01
    assert np.isfinite(mended).all()


def test_one_direction_and_coloured_lights_mend_nothing(views: list[View], fine: Level) -> None:
    lights = lit_ball.lights_of_rig(lit_ball.small_rig(), ("full",))
    mesh = ball(resolution=20)
    seen = seen_by(fine, mesh)
    coloured = dataclasses.replace(LIGHTS, colour_spread=0.5)
    for given in (lights, coloured):
        assert mended_normals(fine, 1, views, seen, mesh, *rays_of(mesh), given) is None


def test_grey_clipped_and_background_pixels_have_no_signal() -> None:
    camera = textured_ball.cameras(1)[0]
    shape = camera.height_px, camera.width_px
    images = np.full((3, *shape, 3), [0.5, 0.3, 0.2], np.float32)
    images[:, :, :50] = 0.4
    valid, mask = np.ones(shape, bool), np.ones(shape, bool)
    valid[:20], mask[-20:] = False, False
    basis = np.ones((3, 3, 4))
    normals = np.zeros((*shape, 3), np.float32)
    view = make_view(camera, images, valid, mask, normals, basis, np.ones(3))
    assert view.signal is not None
    known = np.isfinite(view.signal).all(axis=2)
    assert not known[:20].any()
    assert not known[-20:].any()
    assert not known[:, :50].any()
    assert known[20:-20, 50:].all()


def test_two_looks_have_fewer_outliers_than_one(views: list[View]) -> None:
    once = dataclasses.replace(CONFIG, look_again=False)
    level, depths, costs = match_views(views, CONFIG)
    error = []
    for config in (once, CONFIG):
        first = level, [each.copy() for each in depths], [each.copy() for each in costs]
        mesh = reconstruct_in_two_rounds(views, first, config)[2]
        error.append(np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS_MM))
    assert np.median(error[1]) < 0.05
    assert np.percentile(error[1], 95) < np.percentile(error[0], 95)
