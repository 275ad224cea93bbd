"""Relief, creases, gloss and looks: what the maps must show, measured on them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import vertex_normals
from sim.errors import SimError
from sim.head.grid import COLUMNS, ROWS
from sim.head.maps import at_grid, grid_window, surface_normals, to_tile
from sim.head.mesh import landmarks, neutral_mesh
from sim.people.person import parametric_subject, person_expressions, person_skin
from sim.people.traits import LOOKS, Traits
from sim.skin.chart import curve, draw_lines, empty
from sim.skin.creases import Line, crease_chart, crease_depths, person_lines
from sim.skin.noise import cell_edges, spots
from sim.skin.normals import bend_normals
from sim.skin.paint import make_skin, random_complexion
from sim.skin.parts import Face, Patch, face_from, face_of

PERSON = Traits("female", 30.0, 3)


def dense_normals(points: np.ndarray) -> np.ndarray:
    """Area-weighted normals of the mesh of all texels: (h, w, 3)."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d), (a, b, d), (b, c, d))]
    )
    return vertex_normals(points.reshape(-1, 3).astype(float), triangles).reshape(points.shape)


def angles_deg(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((one * two).sum(axis=-1), -1, 1)))


def sphere(rows: int, columns: int, texel_mm: float) -> np.ndarray:
    """(rows, columns, 3) unit vectors of a patch of a sphere, rows downward."""
    a, b = np.meshgrid((np.arange(columns) - columns / 2), (np.arange(rows) - rows / 2))
    x, y = a * texel_mm / 90, -b * texel_mm / 90
    return np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], axis=-1)


def close_up(rows: int, top: float, left: float, side: int) -> Face:
    """A square of our vertex grid spread over so many rows, as a texture of its own."""
    u, v = (np.arange(side) + left * rows * 2 / 3) / (rows * 2 / 3), np.arange(side) + top * rows
    uv = np.stack(np.meshgrid(u, 1 - v / rows), axis=-1)
    positions = at_grid(
        neutral_mesh().vertices,
        ((1 - uv[..., 1]) * ROWS).astype(np.float32),
        (uv[..., 0] * COLUMNS).astype(np.float32),
    )
    return face_from(positions, uv, np.ones((side, side), bool), 3)


def test_normals_of_pores_are_those_of_a_really_displaced_mesh():
    face = close_up(6144, 0.45, 0.62, 220)
    rng = np.random.default_rng(3)
    skin = make_skin(random_complexion(rng, Traits("male", 60.0, 2)), face, rng)
    height = skin.height_mm("smile").astype(float)
    unit = sphere(*height.shape, 0.06)
    found = bend_normals(90 * unit, unit, height)
    displaced = dense_normals((90 + height[..., None]) * unit)
    apart = angles_deg(found, displaced)[2:-2, 2:-2]
    tilt = angles_deg(displaced, unit)[2:-2, 2:-2]
    assert np.median(tilt) > 3
    assert np.median(apart) < 0.5
    assert np.percentile(apart, 99) < 3


def test_normals_follow_the_relief_on_the_posed_head():
    person = parametric_subject("p", 5, "smile", 192, PERSON)
    points = to_tile(person.mesh.vertices, 192, 128)
    # Bumps of 12 mm, wide enough for these texels.
    places = to_tile(neutral_mesh().vertices, 192, 128)
    height = 0.4 * np.sin(places / 2.0).sum(axis=-1).astype(np.float32)
    smooth = surface_normals(person.mesh, np.zeros_like(height))
    bent = surface_normals(person.mesh, height)
    # The mesh has facets; the relief's share is what a displaced facet turns by.
    change = dense_normals(points + height[..., None] * smooth) - dense_normals(points)
    off = np.degrees(np.linalg.norm((bent - smooth) - change, axis=-1))
    turned = np.degrees(np.linalg.norm(change, axis=-1))
    face = person.skin & (points[..., 2] > points[..., 2].max() - 60)
    assert np.median(turned[face]) > 5
    assert np.median(off[face]) < 0.1 * np.median(turned[face])


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]),
    st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e30, -5.0]),
    st.integers(0, 5),
)
def test_bent_normals_are_unit_or_zero_whatever_the_input(scale, bad, seed):
    rng = np.random.default_rng(seed)
    unit = sphere(7, 6, 3.0)
    position, height = scale * 90 * unit, scale * rng.normal(size=(7, 6))
    height[3, 2] = bad
    position[5, 4] = position[5, 3]
    if seed == 0:
        position[:] = position[0, 0]
    if seed == 1:
        unit[1, 1] = bad
    covered = rng.uniform(size=(7, 6)) < 0.8
    found = bend_normals(position, unit, height, covered)
    length = np.linalg.norm(found, axis=-1)
    assert np.isfinite(found).all()
    assert (np.isclose(length, 1, atol=1e-4) | (length == 0)).all()
    assert (length[~covered] == 0).all()


def test_a_seam_between_charts_bends_no_normal():
    unit = sphere(8, 8, 0.5)
    position = 90 * unit
    position[:, 4:] += (500.0, 0, 0)
    height = np.zeros((8, 8))
    height[:, 4:] = 3.0
    found = bend_normals(position, unit, height, reach_mm=5.0)
    assert np.abs(found - unit).max() < 1e-5


def test_specular_albedo_varies_by_a_factor_of_two_over_the_face():
    for seed, who in ((1, PERSON), (2, Traits("male", 60.0, 5))):
        skin = person_skin(seed, who, 480)
        points = to_tile(neutral_mesh().vertices, 480, 320)
        face = skin.skin & (points[..., 2] > 20) & (points[..., 1] > -115)
        low, high = np.percentile(skin.specular_albedo[face], (5, 95))
        assert 1.7 < high / low < 2.4
        marks = points.reshape(-1, 3)

        def near(place, image=skin.specular_albedo, marks=marks):
            close = np.linalg.norm(marks - np.asarray(place, np.float32), axis=-1) < 5
            return image.reshape(-1)[close].mean()

        tip, below = neutral_mesh().vertices[landmarks()[[30, 46]]]
        assert near(tip) > 1.25 * near(below - (0, 12, 0))


def test_lips_and_eyes_are_smoother_and_ears_more_translucent_than_the_cheek():
    skin = person_skin(4, PERSON, 384)
    masks = {
        name: np.concatenate([p.mask(name) for p in skin.face.strips()]) > 0.9
        for name in ("lips", "eyes", "ears")
    }
    points = to_tile(neutral_mesh().vertices, 384, 256)
    cheek = np.linalg.norm(points - neutral_mesh().vertices[landmarks()[14]], axis=-1) < 8
    assert skin.roughness[masks["lips"]].mean() < skin.roughness[cheek].mean() - 0.04
    assert skin.roughness[masks["eyes"]].max() < 0.12
    assert skin.translucency[masks["ears"]].mean() > skin.translucency[cheek].mean() + 0.2
    assert skin.translucency[masks["lips"]].mean() > skin.translucency[cheek].mean() + 0.15


def test_age_deepens_the_lines_and_an_expression_its_own():
    depth = crease_depths(0.2, None)
    assert all(crease_depths(0.9, None)[name] > depth[name] for name in depth)
    for expression, group in (
        ("smile", "crow"),
        ("smile", "folds"),
        ("brow_raise", "forehead"),
        ("brow_furrow", "glabella"),
        ("pucker", "lips"),
    ):
        assert crease_depths(0.2, expression)[group] > 2 * depth[group]
    lines = person_lines(np.random.default_rng(2))
    smile = crease_chart(lines, crease_depths(0.5, "smile")).picture
    rest = crease_chart(lines, crease_depths(0.5, None)).picture
    assert smile.min() < 1.3 * rest.min() < 0
    assert abs(smile.mean()) < 0.05 * np.abs(smile).max()


def test_a_crease_is_as_deep_as_it_says():
    straight = np.stack([np.linspace(-20, 20, 9), np.full(9, 40.0)], axis=1)
    line = Line("forehead", straight, np.ones(9))
    chart = crease_chart((line,), crease_depths(1.0, None))
    assert -chart.picture.min() == pytest.approx(crease_depths(1.0, None)["forehead"], rel=0.25)
    assert chart.picture.max() > 0.02


def test_expressions_of_one_person_share_the_painted_skin():
    rest, smile = person_expressions("p", 6, ["neutral", "smile"], 96, PERSON)
    alone = parametric_subject("p", 6, "smile", 96, PERSON)
    assert smile.diffuse_albedo is rest.diffuse_albedo
    assert smile.normal.tobytes() == alone.normal.tobytes()
    assert smile.normal.tobytes() != rest.normal.tobytes()
    assert alone.specular_albedo.tobytes() == rest.specular_albedo.tobytes()


def test_our_own_tile_given_as_a_foreign_texture_is_painted_alike():
    rows, columns = 96, 64
    row, column = grid_window(rows, columns, 0, rows)
    uv = np.stack([column / COLUMNS, 1 - row / ROWS], axis=-1)
    positions = to_tile(neutral_mesh().vertices, rows, columns)
    foreign = face_from(positions, uv, np.ones((rows, columns), bool), 9)
    own = Face(rows, columns, 9, foreign.texel_mm)
    maps = []
    for face in (own, foreign):
        rng = np.random.default_rng(1)
        maps.append(make_skin(random_complexion(rng, PERSON), face, rng))
    assert np.allclose(maps[0].diffuse_albedo, maps[1].diffuse_albedo, atol=2e-3)
    assert np.allclose(maps[0].relief_mm, maps[1].relief_mm, atol=2e-3)


def test_texels_off_the_head_are_filled_and_never_scored():
    rows, columns = 96, 64
    u, v = (np.arange(columns) + 0.5) / columns, 1 - (np.arange(rows) + 0.5) / rows
    uv = np.stack(np.meshgrid(u, v), axis=-1).astype(np.float32)
    positions = to_tile(neutral_mesh().vertices, rows, columns)
    covered = np.zeros((rows, columns), bool)
    covered[20:80, 10:50] = True
    uv[~covered], positions[~covered] = np.nan, np.nan
    face = face_from(positions, uv, covered, 2)
    rng = np.random.default_rng(1)
    skin = make_skin(random_complexion(rng, PERSON), face, rng)
    assert np.isfinite(skin.diffuse_albedo).all()
    assert not skin.skin[~covered].any()
    assert skin.skin[covered].any()


@pytest.mark.parametrize("wrong", ["shape", "nothing", "nan", "outside"])
def test_a_texture_that_lies_on_no_head_is_refused(wrong):
    positions, uv = np.zeros((8, 6, 3)), np.full((8, 6, 2), 0.5)
    covered = np.ones((8, 6), bool)
    if wrong == "shape":
        uv = uv[:, :4]
    if wrong == "nothing":
        covered[:] = False
    if wrong == "nan":
        positions[2, 2] = np.nan
    if wrong == "outside":
        uv[3, 3] = 1.4
    with pytest.raises(SimError):
        face_from(positions, uv, covered, 1)


def test_strips_leave_no_trace():
    whole = face_of(96, 64, 3)
    parts = list(whole.strips())
    assert len(parts) == 1
    split = [Patch(whole, k, k + 8) for k in range(0, 96, 8)]
    for draw in (
        lambda p: p.noise(45.0, 2, 1),
        lambda p: p.noise(2.0, 2, 2),
        lambda p: p.mask("beard"),
    ):
        assert np.allclose(np.concatenate([draw(p) for p in split]), draw(parts[0]), atol=1e-5)


@pytest.mark.parametrize("look", LOOKS)
def test_each_look_changes_what_it_names(look):
    plain = person_skin(7, PERSON, 96)
    other = person_skin(7, Traits(PERSON.sex, PERSON.age_years, PERSON.tone, look), 96)
    face = plain.skin & other.skin
    differ = {
        name: float(np.abs(getattr(plain, name) - getattr(other, name))[face].mean())
        for name in ("diffuse_albedo", "specular_albedo", "roughness")
    }
    assert other.distribution == ("ggx" if look == "ggx" else "beckmann")
    assert (other.anisotropy is not None) == (look == "anisotropic")
    if look in ("plain", "ggx", "anisotropic"):
        assert max(differ.values()) == 0
    if look in ("oily", "dry", "make-up"):
        assert differ["roughness"] > 0.003
        assert differ["specular_albedo"] > 0.0003
    if look in ("make-up", "freckled"):
        assert differ["diffuse_albedo"] > 0.002


def test_net_is_zero_on_borders_and_spots_add_up():
    points = np.random.default_rng(0).uniform(-5, 5, (4000, 3)).astype(np.float32)
    edge = cell_edges(points, 1.0, 3)
    assert edge.min() >= 0
    assert edge.min() < 0.02
    assert np.isnan(cell_edges(np.array([[np.nan, 0, 0]], np.float32), 1.0, 3)[0])
    found = spots(points, np.zeros((2, 3)), np.array([1.0, 2.0]), np.array([0.5, 0.25]))
    away = np.linalg.norm(points, axis=1)
    assert np.allclose(found[away < 0.6], 0.75)
    assert (found[away > 2.5] == 0).all()
    nowhere = np.full((1, 3), np.nan, np.float32)
    assert spots(nowhere, np.zeros((1, 3)), np.ones(1), np.ones(1))[0] == 0


def test_lines_beyond_a_chart_are_cut_and_curves_meet_their_points():
    chart = empty(-5, 5, -5, 5, 0.5)
    draw_lines(
        chart, [np.array([[-20.0, 0], [20, 0]]), np.array([[90.0, 0], [99, 0]])], [[1.0]] * 2
    )
    assert chart.picture.max() > 0.6
    values = chart.look_up(np.array([[0.0, 99, np.nan]]), np.array([[0.0, 0, 0]]))
    assert values[0, 0] > 0.3
    assert (values[0, 1:] == 0).all()
    path = curve([(0, 0), (3, 4), (9, 1)], 25)
    for point in ((0, 0), (3, 4), (9, 1)):
        assert np.linalg.norm(path - point, axis=1).min() < 1e-6
