"""The UV layout of our own head: full, without overlap, and with little stretch on the skin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh
from processing.template.uv_faults import overlapping, stretch_of
from sim.head.grid import COLUMNS, ROWS
from sim.head.layout import layout
from sim.head.maps import at_grid, grid_window, over_grid, to_tile, to_window
from sim.head.mesh import grid_places, grid_vertices, neutral_mesh, regions
from sim.head.unwrap import make_layout, unwrapped
from sim.light.texture import raster_uv, texture_of


def test_the_layout_that_is_kept_is_what_its_maker_gives():
    assert np.abs(make_layout() - layout()).max() < 1e-5


def test_the_tile_is_full_and_no_triangle_is_turned_over_or_shares_a_texel():
    mesh = neutral_mesh()
    a, b, c = np.moveaxis(mesh.uvs[mesh.triangle_uvs()], 1, 0)
    areas = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(1.0, abs=1e-6)
    assert not overlapping(mesh, 1536)[0].any()
    for rows in (96, 768):
        assert (raster_uv(mesh, rows, rows * 2 // 3)[0] >= 0).all()


def test_the_two_sides_of_a_face_mirror_each_other():
    uv = layout()
    assert np.abs(uv - (1, 0) - uv[:, ::-1] * (-1, 1)).max() < 1e-6


def test_skin_is_hardly_stretched_and_the_face_is_finer_than_the_back():
    mesh = neutral_mesh()
    stretch = stretch_of(mesh, 6144)

    def of(region: str) -> np.ndarray:
        return np.isin(mesh.triangles(), regions()[region]).all(axis=1)

    angle, area, texel_mm = stretch.of(of("skin"), 0.95)
    # By the grid spread evenly over the tile: 100 degrees and 4.2; ICT's own layout: 55 and 3.4.
    assert angle < 40
    assert area < 1.8
    assert texel_mm < 0.07
    assert stretch.of(of("hair"), 0.5)[2] > 1.4 * texel_mm


def flat_grid(rows: int, columns: int, height: float, width: float) -> tuple[np.ndarray, ...]:
    """A flat rectangle of (rows + 1, columns + 1) points, and its triangles."""
    x = np.arange(columns + 1) / columns * width
    y = (1 - np.arange(rows + 1) / rows) * height
    points = np.stack([*np.meshgrid(x, y), np.zeros((rows + 1, columns + 1))], axis=-1)
    index = np.arange(points[..., 0].size).reshape(rows + 1, columns + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    first = np.stack([a, b, c], axis=-1).reshape(-1, 3)
    return points, np.concatenate([first, np.stack([a, c, d], axis=-1).reshape(-1, 3)])


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-6, 1.0, 1e6]))
def test_a_flat_face_is_laid_out_without_any_stretch_wherever_its_points_are(seed, scale):
    points, triangles = flat_grid(6, 4, 3.0, 1.0)
    rng = np.random.default_rng(seed)
    points[1:-1, 1:-1, :2] += rng.uniform(-0.1, 0.1, points[1:-1, 1:-1, :2].shape)
    ones = np.ones(len(triangles))
    uv = unwrapped(scale * points, triangles, ones, ones)
    assert uv.shape == (7, 9, 2)
    assert uv[:, 4:] == pytest.approx(points[..., :2] / (2, 3) + (0.5, 0), abs=0.02)


def test_a_part_that_is_to_be_small_is_small():
    points, triangles = flat_grid(8, 4, 3.0, 1.0)
    above = points.reshape(-1, 3)[triangles].mean(axis=1)[:, 1] > 1.5
    uv = unwrapped(points, triangles, np.ones(len(triangles)), np.where(above, 0.5, 1.0))
    # Half of the face has a third of the tile's height.
    assert uv[4, 4, 1] == pytest.approx(2 / 3, abs=0.06)


def test_rows_of_the_grid_are_those_of_the_whole_tile_and_the_edge_goes_on_beyond():
    whole = grid_window(96, 64, 0, 96)
    part = grid_window(96, 64, 90, 100)
    for one, two in zip(whole, part, strict=True):
        assert (two[:6] == one[90:]).all()
        assert (two[6:] == one[-1]).all()
    above = grid_window(96, 64, -3, 2)
    assert (above[0][:3] == whole[0][0]).all()


def test_values_in_the_tile_are_those_of_the_triangles_and_in_the_grid_of_the_grid():
    mesh = neutral_mesh()
    face, weights = raster_uv(mesh, 384, 256)
    plain = texture_of(mesh.vertices, mesh.triangles(), face, weights)
    apart = np.linalg.norm(to_tile(mesh.vertices, 384, 256) - plain, axis=-1)
    assert np.median(apart) < 0.02
    assert np.quantile(apart, 0.999) < 1.0
    flat = Mesh(mesh.vertices, mesh.faces, grid_places(), mesh.face_uvs)
    face, weights = raster_uv(flat, 384, 256)
    plain = texture_of(mesh.vertices, mesh.triangles(), face, weights)
    apart = np.linalg.norm(over_grid(mesh.vertices, 384, 256) - plain, axis=-1)
    assert np.median(apart) < 0.02
    assert (to_window(mesh.vertices, 384, 256, 7, 9) == to_tile(mesh.vertices, 384, 256)[7:9]).all()


def test_a_grids_place_comes_back_where_the_tile_shows_it():
    row, column = grid_window(768, 512, 0, 768)
    of_vertices = np.zeros((int(grid_vertices().max()) + 1, 2))
    of_vertices[grid_vertices()] = layout()
    uv = at_grid(of_vertices, row, column)
    texel = np.stack(np.meshgrid(np.arange(512) + 0.5, 767.5 - np.arange(768)), axis=-1)
    apart = np.linalg.norm(uv * (512, 768) - texel, axis=-1)
    # Within a quad the grid is bilinear and the tile of two triangles; the seam has two UV.
    assert np.median(apart) < 0.02
    assert row.max() < ROWS
    assert column.max() < COLUMNS
