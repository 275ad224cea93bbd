from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.render.occlusion import PositionGrid, bake_grid, bake_visibility
from learning.render.uv import rasterise, spread_outside, texel_surface
from learning.render.view import render_view, sample_bilinear
from lightstage.errors import FormatError
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera, look_at


def sheet(size_mm: float = 100.0, height_mm: float = 0.0) -> Mesh:
    """A square facing +z whose UV fills the tile."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    vertices = np.concatenate([corners * size_mm / 2, np.full((4, 1), height_mm)], axis=1)
    faces = np.array([[0, 1, 2, 3]], np.int32)
    return Mesh(vertices, faces, (corners + 1) / 2, faces)


def camera(width: int = 60, height: int = 40) -> Camera:
    pose = look_at(np.array([0.0, 0.0, 500.0]), np.zeros(3))
    dist = (0.0,) * 5
    return Camera("c", "1", "m", width, height, 200.0, 200.0, width / 2, height / 2, dist, pose)


def test_every_texel_of_a_full_tile_is_covered_and_interpolates_exactly() -> None:
    raster = rasterise(sheet(), 30, 20)
    assert raster.covered.all()
    position = raster.interpolate(sheet().vertices)
    x = ((np.arange(20) + 0.5) / 20 - 0.5) * 100
    y = -((np.arange(30) + 0.5) / 30 - 0.5) * 100
    np.testing.assert_allclose(position[..., 0], np.broadcast_to(x, (30, 20)), atol=1e-4)
    np.testing.assert_allclose(position[..., 1], np.broadcast_to(y[:, None], (30, 20)), atol=1e-4)


@pytest.mark.parametrize("kind", [np.float64, np.float32, bool])
def test_texels_mix_their_corners_as_a_plain_sum_does(kind: type, ball_mesh: Mesh) -> None:
    assert ball_mesh.uvs is not None
    part = Mesh(ball_mesh.vertices, ball_mesh.faces, 0.8 * ball_mesh.uvs, ball_mesh.face_uvs)
    raster = rasterise(part, 48, 32)
    given = np.random.default_rng(1).normal(size=(len(ball_mesh.vertices), 4)).astype(kind)
    corners = given.astype(float)[raster.triangles[raster.face]]
    plain = np.einsum("hwck,hwc->hwk", corners, raster.barycentric.astype(float))
    plain[~raster.covered] = 0
    assert 0 < raster.covered.sum() < raster.covered.size
    np.testing.assert_allclose(raster.interpolate(given), plain, atol=1e-6)


@settings(max_examples=50, deadline=None)
@given(corners=st.lists(st.tuples(st.floats(-2, 3), st.floats(-2, 3)), min_size=3, max_size=3))
def test_any_triangle_covers_the_texels_inside_it(corners: list[tuple[float, float]]) -> None:
    uvs = np.array(corners)
    area = np.cross(*(np.c_[uvs[1:] - uvs[0], [0, 0]]))[2]
    face = np.array([[0, 1, 2]], np.int32)
    mesh = Mesh(np.eye(3), face, uvs, face)
    u, v = np.meshgrid((np.arange(16) + 0.5) / 16, 1 - (np.arange(24) + 0.5) / 24)
    points = np.stack([u, v], axis=-1)
    sides = [
        (uvs[(i + 1) % 3, 0] - uvs[i, 0]) * (points[..., 1] - uvs[i, 1])
        - (uvs[(i + 1) % 3, 1] - uvs[i, 1]) * (points[..., 0] - uvs[i, 0])
        for i in range(3)
    ]
    inside = np.min(np.array(sides) * np.sign(area), axis=0)
    clear = np.abs(inside) > 1e-6
    try:
        covered = rasterise(mesh, 24, 16).covered
    except FormatError:
        covered = np.zeros((24, 16), bool)
    if abs(area) > 1e-6:
        np.testing.assert_array_equal(covered[clear], (inside > 0)[clear])
    else:
        assert covered.sum() <= 40


def test_a_mesh_without_uv_is_refused() -> None:
    with pytest.raises(FormatError, match="uv: found none"):
        rasterise(Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32)), 8, 8)


def test_position_map_of_a_ball_gives_its_normals_and_area(ball_mesh: Mesh) -> None:
    raster = rasterise(ball_mesh, 192, 256)
    position = raster.interpolate(ball_mesh.vertices)
    surface = texel_surface(position, raster.covered)
    direction = position / np.linalg.norm(position, axis=2, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((surface.normal * direction).sum(axis=2), -1, 1)))
    assert np.median(angle) < 1.0
    assert np.percentile(angle[20:-20], 99) < 4.0
    assert surface.area_mm2.sum() == pytest.approx(4 * np.pi * 90.0**2, rel=0.03)


def test_a_seam_of_the_texture_is_no_slope() -> None:
    flat = rasterise(sheet(), 32, 32).interpolate(sheet().vertices)
    flat[:, 16:] += (500.0, 0.0, 300.0)
    surface = texel_surface(flat, np.ones((32, 32), bool))
    np.testing.assert_allclose(surface.normal, np.broadcast_to([0, 0, 1.0], (32, 32, 3)), atol=1e-5)


def test_no_surface_gives_zeros() -> None:
    surface = texel_surface(np.zeros((8, 8, 3)), np.zeros((8, 8), bool))
    assert not surface.normal.any()
    assert not surface.area_mm2.any()


def test_spreading_takes_the_nearest_known_texel() -> None:
    image = np.arange(5.0)[None, :, None]
    known = np.array([[False, True, False, False, True]])
    assert spread_outside(image, known)[0, :, 0].tolist() in ([1, 1, 1, 4, 4], [1, 1, 1, 1, 4])


def stacked(a: Mesh, b: Mesh) -> Mesh:
    """Two sheets, b's UV outside the tile, so that a alone is textured."""
    assert a.uvs is not None
    assert b.uvs is not None
    faces = np.concatenate([a.faces, b.faces + 4])
    return Mesh(
        np.concatenate([a.vertices, b.vertices]), faces, np.concatenate([a.uvs, b.uvs + 5]), faces
    )


def test_shadow_of_a_square_lies_where_geometry_says() -> None:
    mesh = stacked(sheet(100.0), sheet(20.0, height_mm=10.0))
    raster = rasterise(mesh, 100, 100)
    lights = np.array([[0.0, 0.0, 1e6], [1e6, 0.0, 1e6], [0.0, 0.0, -1e6]])
    for distant in (False, True):
        seen = bake_visibility(mesh, raster, lights, np.full(3, distant))
        x, y = (np.arange(100) + 0.5) - 50, 50 - (np.arange(100) + 0.5)
        middle = (np.abs(x)[None] < 9) & (np.abs(y)[:, None] < 9)
        around = (np.abs(x)[None] > 11) | (np.abs(y)[:, None] > 11)
        assert not seen[0][middle].any()
        assert seen[0][around].all()
        # Light from 45 degrees along +x moves the shadow by the square's height toward -x.
        moved = (np.abs(x + 10)[None] < 9) & (np.abs(y)[:, None] < 9)
        assert not seen[1][moved].any()
        assert seen[1][(np.abs(x + 10)[None] > 11) | (np.abs(y)[:, None] > 11)].all()
        assert not seen[2].any()


def test_shadows_on_a_position_map_equal_those_on_the_mesh(ball_mesh: Mesh) -> None:
    raster = rasterise(ball_mesh, 96, 64)
    surface = PositionGrid(
        raster.interpolate(ball_mesh.vertices), raster.normals(ball_mesh), raster.covered
    )
    lights = np.array([[900.0, 300.0, 400.0], [0.0, 0.0, 1250.0]])
    on_mesh = bake_visibility(ball_mesh, raster, lights, np.zeros(2, bool))
    assert (bake_grid(surface, lights) != on_mesh).mean() < 0.01


def test_each_pixel_shows_the_texel_its_ray_meets() -> None:
    rows, columns = 40, 40
    texture = np.zeros((rows, columns, 3), np.float32)
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, 1 - (np.arange(rows) + 0.5) / rows)
    texture[..., 0], texture[..., 1] = u, v
    view = camera()
    rgb, alpha = render_view(texture, np.ones((rows, columns), bool), sheet(), view, 1.0)
    x = ((np.arange(60) + 0.5) - 30) / 200 * 500
    y = -((np.arange(40) + 0.5) - 20) / 200 * 500
    inside = (np.abs(x)[None] < 47) & (np.abs(y)[:, None] < 47)
    assert inside.any()
    expected = np.stack(np.broadcast_arrays(x[None] / 100 + 0.5, y[:, None] / 100 + 0.5), axis=-1)
    np.testing.assert_allclose(rgb[..., :2][inside], expected[inside], atol=2e-3)
    np.testing.assert_allclose(alpha[inside], 1)
    outside = np.broadcast_to(np.abs(x)[None] > 53, alpha.shape)
    np.testing.assert_allclose(rgb[outside], 1)
    assert not alpha[outside].any()


def test_texels_that_are_not_known_are_not_shown() -> None:
    known = np.zeros((10, 10), bool)
    known[:, :5] = True
    rgb, alpha = render_view(np.ones((10, 10, 3)), known, sheet(), camera(), 0.0)
    assert alpha[20, 22] == 1
    assert alpha[20, 40] == 0
    assert rgb[20, 40].tolist() == [0, 0, 0]


def test_bilinear_sampling_is_exact_at_centres_and_linear_between() -> None:
    image = np.random.default_rng(0).uniform(size=(4, 3, 2))
    centres = np.array([[(c + 0.5) / 3, 1 - (r + 0.5) / 4] for r in range(4) for c in range(3)])
    np.testing.assert_allclose(sample_bilinear(image, centres), image.reshape(-1, 2))
    between = sample_bilinear(image, np.array([[2 / 6 + 0 / 3, 1 - 0.5 / 4]]))
    np.testing.assert_allclose(between[0], (image[0, 0] + image[0, 1]) / 2)
    assert np.isfinite(sample_bilinear(image, np.array([[-3.0, 7.0]]))).all()
