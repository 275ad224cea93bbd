import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.atlas.fill import MeshFill, mirrored_vertices
from processing.atlas.finish import gutter_sources, picture, towards
from processing.atlas.raster import overlap_share, rasterise, texel_size_mm
from tests.processing.shapes import ellipsoid

SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def plain(uvs, triangle_uvs, rows, columns):
    """The rasteriser in plain float64: the first triangle that holds each texel's centre."""
    face = np.full((rows, columns), -1)
    barycentric = np.zeros((rows, columns, 3))
    for row in range(rows):
        for column in range(columns):
            p = np.array([(column + 0.5) / columns, 1 - (row + 0.5) / rows])
            for t, corners in enumerate(triangle_uvs):
                a, b, c = uvs[corners]
                matrix = np.array([b - a, c - a]).T
                if abs(np.linalg.det(matrix)) < 1e-15:
                    continue
                b1, b2 = np.linalg.solve(matrix, p - a)
                if min(b1, b2, 1 - b1 - b2) >= 0:
                    face[row, column] = t
                    barycentric[row, column] = 1 - b1 - b2, b1, b2
                    break
    return face, barycentric


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    size=st.sampled_from([1e-6, 0.02, 0.2, 1.0]),
    rows=st.sampled_from([6, 15, 24]),
)
def test_rasteriser_agrees_with_its_plain_twin(seed, size, rows):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(size=(12, 1, 2))
    uvs = np.clip(centres + size * rng.normal(size=(12, 3, 2)), 0, 1).reshape(-1, 2)
    triangles = np.arange(36).reshape(12, 3)
    columns = rows * 2 // 3
    found = rasterise(uvs, triangles, rows, columns)
    face, barycentric = plain(uvs, triangles, rows, columns)
    # A centre within rounding of an edge may go either way.
    sure = (face < 0) | (barycentric.min(axis=2) > 1e-9)
    assert np.array_equal(found.face[sure], face[sure])
    both = (found.face == face) & (face >= 0)
    assert np.allclose(found.barycentric[both], barycentric[both][:, 1:], atol=1e-5)
    assert found.barycentric.min() >= 0
    assert found.barycentric.sum(axis=2, dtype=float).max() <= 1


def test_every_texel_of_a_covered_tile_is_covered_once_and_edges_leave_no_gap():
    rng = np.random.default_rng(0)
    for _ in range(20):
        # A square cut from a random inner point: edges pass through texel centres at times.
        inner = rng.integers(1, 12, size=2) / 12
        uvs = np.concatenate([SQUARE, [inner]])
        fans = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
        found = rasterise(uvs, fans, 18, 12)
        assert (found.face >= 0).all()


def test_a_centre_on_a_shared_edge_goes_to_the_first_triangle():
    found = rasterise(SQUARE, HALVES, 12, 12)
    diagonal = found.face[::-1].diagonal()
    assert (diagonal == 0).all()
    flipped = rasterise(SQUARE, HALVES[::-1], 12, 12)
    assert (flipped.face[::-1].diagonal() == 0).all()


def test_winding_does_not_matter():
    one = rasterise(SQUARE, HALVES, 9, 6)
    other = rasterise(SQUARE, HALVES[:, ::-1], 9, 6)
    assert np.array_equal(one.face, other.face)


def test_degenerate_and_broken_triangles_hold_nothing():
    uvs = np.array([[0.0, 0], [0.5, 0.5], [1, 1], [0.5, 0.5], [np.nan, 0.2], [0.3, np.inf]])
    triangles = np.array([[0, 1, 2], [1, 1, 3], [0, 4, 2], [0, 1, 4]])
    assert (rasterise(uvs, triangles, 12, 8).face == -1).all()


def test_a_triangle_of_one_texel_is_found_where_it_holds_the_centre():
    rows, columns = 30, 20
    centre = np.array([(7 + 0.5) / columns, 1 - (11 + 0.5) / rows])
    around = np.array([[-0.4, -0.3], [0.4, -0.3], [0, 0.5]]) / [columns, rows]
    found = rasterise(centre + around, np.array([[0, 1, 2]]), rows, columns)
    assert np.argwhere(found.face >= 0).tolist() == [[11, 7]]
    beside = rasterise(centre + around + 0.5 / columns, np.array([[0, 1, 2]]), rows, columns)
    assert (beside.face < 0).all()


def test_row_zero_is_the_top_and_positions_interpolate_linearly():
    rows, columns = 33, 22
    found = rasterise(SQUARE, HALVES, rows, columns)
    values = found.at(np.concatenate([SQUARE * [2, 3], np.ones((4, 1))], axis=1), HALVES)
    values = values.reshape(rows, columns, 3)
    assert np.allclose(values[0, :, 1], 3 * (1 - 0.5 / rows), atol=1e-5)
    assert np.allclose(values[:, 4, 0], 2 * 4.5 / columns, atol=1e-5)
    assert np.allclose(values[..., 2], 1)


def test_texel_size_is_that_of_the_surface():
    flat = np.concatenate([SQUARE * [200, 300], np.zeros((4, 1))], axis=1)
    size = texel_size_mm(flat, HALVES, SQUARE, HALVES, 600, 400)
    assert np.allclose(size, 0.5)
    none = texel_size_mm(flat, HALVES, SQUARE * 0, HALVES, 600, 400)
    assert np.isinf(none).all()


def test_gutter_copies_the_nearest_texel_and_ends():
    covered = np.zeros((40, 40), bool)
    covered[10:20, 10:20] = True
    gutter, source = gutter_sources(covered, 5)
    rows, columns = np.divmod(gutter, 40)
    source_rows, source_columns = np.divmod(source, 40)
    assert np.array_equal(source_rows, np.clip(rows, 10, 19))
    assert np.array_equal(source_columns, np.clip(columns, 10, 19))
    distance = np.hypot(rows - source_rows, columns - source_columns)
    assert distance.max() <= 5.3
    straight = (rows == 15) | (columns == 15)
    assert straight.sum() == 4 * 5
    assert not covered.ravel()[gutter].any()


@pytest.mark.parametrize("covered", [np.ones((6, 4), bool), np.zeros((6, 4), bool)])
def test_no_gutter_where_all_or_nothing_is_covered(covered):
    assert len(gutter_sources(covered, 16)[0]) == 0


@pytest.mark.parametrize("channels", [(), (1,), (3,)])
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int16])
def test_a_picture_holds_its_texels_and_the_gutter_in_floats_of_either_size(channels, kind):
    rng = np.random.default_rng(4)
    covered = rng.uniform(size=(9, 7)) < 0.3
    texels = rng.permutation(np.flatnonzero(covered)).astype(np.int32)
    values = (100 * rng.normal(size=(len(texels), *channels))).astype(kind)
    if kind != np.int16:
        values.flat[:2] = 1e6, np.nan
    gutter = gutter_sources(covered, 2)
    right = np.full((63, *channels), -1, np.float32)
    right[texels] = values
    right[gutter[0]] = right[gutter[1]]
    right = right.reshape(9, 7, -1)
    with np.errstate(over="ignore"):
        for half, exact in ((False, right), (True, right.astype(np.float16))):
            found = picture(values, (9, 7), texels, gutter, -1.0, half)
            assert found.dtype == exact.dtype
            assert np.array_equal(found, exact, equal_nan=True)


def test_unseen_parts_continue_what_was_seen_across_the_seam():
    mesh = ellipsoid()
    triangles = mesh.triangles()
    assert mesh.uvs is not None
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), 96, 64)
    texels = raster.texels()
    place = raster.at(mesh.vertices, triangles)
    seen = (place[:, 2] > 0).astype(np.float32)
    values = np.where(seen[:, None] > 0, 0.5 + place[:, :1] / 300, np.nan).astype(np.float32)
    values[seen == 0] = 0
    none = np.full(len(mesh.vertices), -1)
    fill = MeshFill(mesh.vertices, triangles, raster, texels, seen, none)
    found = fill.vertex_values(values)[:, 0]
    front = mesh.vertices[:, 2] > 15
    assert np.abs(found - (0.5 + mesh.vertices[:, 0] / 300))[front].max() < 0.02
    assert found.min() > 0.5 - 80 / 300
    assert found.max() < 0.5 + 80 / 300
    edges = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    assert np.abs(np.diff(found[edges], axis=1)).max() < 0.06


def test_filling_with_everything_or_nothing_seen_is_finite():
    mesh = ellipsoid(10, 12)
    assert mesh.uvs is not None
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), 24, 16)
    texels = raster.texels()
    values = np.full((len(texels), 1), 0.25, np.float32)
    for weight, expected in ((1.0, 0.25), (0.0, 0.0)):
        seen = np.full(len(texels), weight, np.float32)
        mirror = mirrored_vertices(mesh.vertices, 1.0)
        fill = MeshFill(mesh.vertices, mesh.triangles(), raster, texels, seen, mirror)
        assert np.allclose(fill.vertex_values(values), expected, atol=1e-5)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32),
    rows=st.sampled_from([24, 60, 96]),
    black_or_white=st.booleans(),
    seen_share=st.sampled_from([0.0, 0.02, 0.3, 1.0]),
    faintest=st.sampled_from([1e-30, 1e-6, 1.0]),
    two_sides=st.booleans(),
)
def test_filled_albedo_stays_between_black_and_white(
    seed, rows, black_or_white, seen_share, faintest, two_sides
):
    rng = np.random.default_rng(seed)
    mesh = ellipsoid(8, 12)
    triangles = mesh.triangles()
    assert mesh.uvs is not None
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), rows, rows * 2 // 3)
    texels = raster.texels()
    weight = faintest ** rng.uniform(size=len(texels)) * (
        rng.uniform(size=len(texels)) < seen_share
    )
    weight = weight.astype(np.float32)
    values = rng.uniform(size=(len(texels), 3)).astype(np.float32)
    values = np.round(values) if black_or_white else values
    none = np.full(len(mesh.vertices), -1)
    mirror = mirrored_vertices(mesh.vertices, 1.0) if two_sides else none
    fill = MeshFill(mesh.vertices, triangles, raster, texels, weight, mirror)
    guess = fill.vertex_values(values)
    assert 0 <= guess.min() <= guess.max() <= 1
    towards(values, guess, raster, triangles, texels, weight)
    assert 0 <= values.min() <= values.max() <= 1


def test_the_other_side_is_a_better_guess_than_the_surroundings():
    mesh = ellipsoid()
    triangles = mesh.triangles()
    assert mesh.uvs is not None
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), 96, 64)
    texels = raster.texels()
    place = raster.at(mesh.vertices, triangles)

    def albedo(points):
        """Symmetric but for a slow slope, with detail that no diffusion guesses."""
        return (
            0.5 + 0.1 * np.cos(points[:, :1] / 6) * np.cos(points[:, 1:2] / 8) + points[:, :1] / 800
        )

    hidden = (place[:, 0] > 20) & (place[:, 0] < 60) & (np.abs(place[:, 1]) < 40)
    weight = (~hidden).astype(np.float32)
    values = np.where(hidden[:, None], 0, albedo(place)).astype(np.float32)
    mirror = mirrored_vertices(mesh.vertices, 1.0)
    assert (mirror >= 0).all()
    errors = []
    for counterpart in (mirror, np.full(len(mirror), -1)):
        fill = MeshFill(mesh.vertices, triangles, raster, texels, weight, counterpart)
        guessed = fill.kind > 0
        found = fill.vertex_values(values)
        errors.append(np.abs(found - albedo(mesh.vertices))[guessed].mean())
        assert guessed.sum() > 50
    assert errors[0] < 0.4 * errors[1]


def test_vertices_without_another_side_are_marked():
    rest = np.array([[10.0, 0, 0], [-10.0, 0.5, 0], [40.0, 5, 5]])
    assert mirrored_vertices(rest, 1.0).tolist() == [1, 0, -1]


def test_overlap_and_what_is_off_the_tile_are_measured():
    mesh = ellipsoid()
    assert mesh.uvs is not None
    for u_of, expected in (
        (lambda u: u, 0.0),
        (lambda u: np.abs(u - 0.5), 0.5),  # both halves on one
        (lambda u: u + 0.25, 0.25),  # a quarter off the tile
    ):
        uvs = mesh.uvs.copy()
        uvs[:, 0] = u_of(uvs[:, 0])
        raster = rasterise(uvs, mesh.triangle_uvs(), 192, 128)
        found = overlap_share(uvs, mesh.triangle_uvs(), raster)
        assert found == pytest.approx(expected, abs=0.02)


def test_triangles_smaller_than_a_texel_lose_none():
    """A grid far finer than the atlas: every texel in it shows the one triangle at its centre."""
    n = 200
    grid = np.stack(np.meshgrid(np.linspace(0.1, 0.9, n), np.linspace(0.1, 0.9, n)), -1)
    uvs = grid.reshape(-1, 2)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + n], axis=1)
    upper = np.stack([corner + 1, corner + n + 1, corner + n], axis=1)
    triangles = np.concatenate([lower, upper])
    raster = rasterise(uvs, triangles, 48, 32)
    inside = raster.face[5:43, 4:28]
    assert (inside >= 0).all()
    place = raster.at(np.c_[uvs, 0 * uvs[:, :1]], triangles)
    rows, columns = np.divmod(raster.texels(), 32)
    assert np.abs(place[:, 0] - (columns + 0.5) / 32).max() < 1e-6
    assert np.abs(place[:, 1] - (1 - (rows + 0.5) / 48)).max() < 1e-6
