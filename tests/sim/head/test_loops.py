"""The topology with closed loops of quads around eyes and mouth."""

from __future__ import annotations

import numpy as np
import open3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh, edge_counts
from lightstage.formats.template import (
    REGIONS,
    Template,
    default_template_path,
    load_template,
    save_template,
)
from processing.registration.flips import crossing_triangles, folded_triangles
from processing.template.check import check_template
from processing.template.uv_faults import overlapping
from sim.errors import SimError
from sim.head import loops_template
from sim.head.grid import COLUMNS, ROWS
from sim.head.layout import layout
from sim.head.loops import EYE_CREASES, loops, point_weights
from sim.head.loops_template import build_loops_template, loops_mesh
from sim.head.mesh import grid_vertices, landmarks, neutral_mesh, regions
from sim.head.modes import EXPRESSIONS, expression_modes, identity_modes
from tests.sim.head.walks import closed_lines, closed_strips, surrounding

EYE_MM, MOUTH_MM = 40.0, 60.0
"""A loop around an eye or the mouth is as near as this to its middle."""


@pytest.fixture(scope="module")
def template() -> Template:
    return build_loops_template()


@pytest.fixture(scope="module")
def middles() -> dict[str, np.ndarray]:
    marks = neutral_mesh().vertices[landmarks()]
    return {
        "right eye": marks[36:42].mean(axis=0),
        "left eye": marks[42:48].mean(axis=0),
        "mouth": marks[60:].mean(axis=0),
    }


def around(mesh: Mesh, middles: dict[str, np.ndarray]) -> dict[str, tuple[int, int]]:
    """Closed rows of quads and closed lines of edges around each opening."""
    strips = closed_strips(mesh)
    lines = [mesh.vertices[line] for line in closed_lines(mesh)]
    out = {}
    for name, middle in middles.items():
        near = MOUTH_MM if name == "mouth" else EYE_MM
        counts = [len(surrounding(each, middle, near)) for each in (strips, lines)]
        out[name] = (counts[0], counts[1])
    return out


def poles(mesh: Mesh) -> dict[int, int]:
    """How many vertices within the surface have each number of edges but four."""
    quads = mesh.faces
    ends = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges, counts = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    valence = np.bincount(edges.ravel(), minlength=len(mesh.vertices))
    inside = np.ones(len(mesh.vertices), bool)
    inside[edges[counts == 1]] = False
    kinds, times = np.unique(valence[inside & (valence != 4)], return_counts=True)
    return dict(zip(kinds.tolist(), times.tolist(), strict=True))


def test_quads_run_in_closed_loops_around_eyes_and_mouth(
    middles: dict[str, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    grid, found = around(neutral_mesh(), middles), around(loops_mesh(), middles)
    with capsys.disabled():
        print(f"\nrows of quads, lines of edges: {found}, of the grid {grid}")
        print(f"poles {poles(loops_mesh())}, of the grid {poles(neutral_mesh())}")
    assert set(grid.values()) == {(0, 0)}
    assert found == {"right eye": (9, 8), "left eye": (9, 8), "mouth": (10, 9)}


def test_poles_are_the_corners_of_the_blocks_and_of_what_fills_the_openings() -> None:
    # Four corners of five edges and four of three for either eye and the mouth; the slit's ends.
    assert poles(neutral_mesh()) == {2: 2}
    assert poles(loops_mesh()) == {2: 2, 3: 12, 5: 12}


def test_the_surface_is_whole_and_mirrors_itself() -> None:
    mesh = loops_mesh()
    assert (mesh.faces >= 0).all()
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    edges, counts = edge_counts(mesh.triangles())
    assert counts.max() == 2
    assert (counts == 1).sum() == COLUMNS  # the neck
    assert len(mesh.vertices) - len(edges) + len(mesh.triangles()) == 1
    away, other = cKDTree(mesh.vertices).query(mesh.vertices * (-1, 1, 1))
    assert away.max() < 1e-9
    mirrored = np.sort(other[mesh.triangles()], axis=1)
    assert {*map(tuple, mirrored.tolist())} == {
        *map(tuple, np.sort(mesh.triangles(), axis=1).tolist())
    }


def test_far_from_eyes_and_mouth_it_is_the_grid() -> None:
    made, mesh = loops(), loops_mesh()
    row, column = made.places.T
    far = (row < 28) | (row > 102) | (np.abs(column - COLUMNS // 2) > 34)
    whole = far & (made.places % 1 == 0).all(axis=1)
    assert whole.sum() == far.sum()
    assert whole.sum() > 0.6 * (ROWS + 1) * (COLUMNS + 1)
    row, column = made.places[whole].astype(int).T
    of_grid = neutral_mesh().vertices[grid_vertices()[row, column]]
    assert np.abs(mesh.vertices[made.vertices[whole]] - of_grid).max() < 1e-12
    assert mesh.uvs is not None
    assert np.abs(mesh.uvs[whole] - layout()[row, column]).max() < 1e-12


def from_grid_mm(of_grid: np.ndarray) -> np.ndarray:
    """Distances of places spread over the grid's face from the other topology's surface."""
    mesh = neutral_mesh()
    at = np.stack(np.divmod(mesh.triangle_uvs(), COLUMNS + 1), axis=-1).mean(axis=1)
    face = (at[:, 0] > 28) & (at[:, 0] < 104) & (np.abs(at[:, 1] - COLUMNS // 2) < 34)
    corners = of_grid[mesh.triangles()[face]]
    weights = np.random.default_rng(0).dirichlet((1, 1, 1), len(corners))
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(loops().carried(of_grid).astype(np.float32)),
        open3d.core.Tensor(loops_mesh().triangles().astype(np.uint32)),
    )
    places = np.einsum("tc,tck->tk", weights, corners).astype(np.float32)
    return np.asarray(scene.compute_distance(open3d.core.Tensor(places)).numpy())


def test_the_surface_is_the_grids_for_the_mean_for_people_and_for_expressions(
    capsys: pytest.CaptureFixture[str],
) -> None:
    mean = neutral_mesh().vertices
    rng = np.random.default_rng(7)
    heads = {"mean": mean}
    for number in range(3):
        modes = np.tensordot(rng.normal(size=len(identity_modes())), identity_modes(), 1)
        heads[f"person {number}"] = mean + modes
    heads |= {name: mean + mode for name, mode in zip(EXPRESSIONS, expression_modes(), strict=True)}
    for name, vertices in heads.items():
        away = from_grid_mm(vertices)
        with capsys.disabled():
            print(f"\n{name}: {away.mean():.3f} mm, 95 % {np.quantile(away, 0.95):.3f}", end="")
        assert away.mean() < 0.03
        assert np.quantile(away, 0.95) < 0.1
        # The grid cuts corners of its own where one cell has wing and nostril of the nose.
        assert np.quantile(away, 0.999) < 1.5


def test_the_texture_is_full_and_no_triangle_is_turned_over_or_shares_a_texel() -> None:
    mesh = loops_mesh()
    assert mesh.uvs is not None
    a, b, c = np.moveaxis(mesh.uvs[mesh.triangle_uvs()], 1, 0)
    areas = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(1.0, abs=1e-6)
    assert not overlapping(mesh, 1536)[0].any()


def corner_angles_deg(mesh: Mesh) -> np.ndarray:
    """(m, 4) of each quad."""
    corners = mesh.vertices[mesh.faces]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * back).sum(axis=2)
    cosine /= np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def test_no_quad_is_sharper_than_the_grids(capsys: pytest.CaptureFixture[str]) -> None:
    grid, found = corner_angles_deg(neutral_mesh()), corner_angles_deg(loops_mesh())
    new = (loops().places[loops().quads] % 1 != 0).any(axis=(1, 2))
    with capsys.disabled():
        print(f"\nleast angle {found.min():.1f}, of new quads {found[new].min():.1f} deg", end="")
        print(f", of the grid {grid.min():.1f}")
    assert found.min() > grid.min() - 1e-6
    assert found[new].min() > 12
    assert found[new].max() < 170


def folds(mesh: Mesh, offset: np.ndarray) -> int:
    return int(folded_triangles(mesh.vertices, mesh.vertices + offset, mesh.triangles()).sum())


def test_no_mode_folds_more_triangles_than_on_the_grid_or_crosses_the_surface() -> None:
    grid, mesh, made = neutral_mesh(), loops_mesh(), loops()
    assert not crossing_triangles(mesh.vertices, mesh.triangles()).any()
    modes = [sign * 2 * mode for mode in identity_modes() for sign in (1, -1)]
    for mode in [*modes, *expression_modes()]:
        carried = made.carried(mode)
        assert folds(mesh, carried) <= folds(grid, mode)
        assert not crossing_triangles(mesh.vertices + carried, mesh.triangles()).any()


def test_check_finds_nothing_that_it_does_not_find_on_the_grid(template: Template) -> None:
    findings, facts = check_template(template)
    assert [each.name for each in findings] == ["modes that fold"]
    assert sum(facts["modes_that_fold"].values()) <= 38  # the grid's


def test_landmarks_are_distinct_and_near_those_of_the_grid(
    template: Template, capsys: pytest.CaptureFixture[str]
) -> None:
    true = neutral_mesh().vertices[landmarks()]
    away = np.linalg.norm(template.mesh.vertices[template.landmarks] - true, axis=1)
    with capsys.disabled():
        print(f"\nlandmarks: {away.mean():.2f} mm in the mean, at most {away.max():.2f}")
    assert len(set(template.landmarks.tolist())) == 68
    assert away.max() < 2.5  # a brow's end, where the grid's columns are 4 mm apart
    assert away[27:].max() < 0.8


def test_each_vertex_has_one_region_and_lips_end_where_the_grids_do(template: Template) -> None:
    assert set(template.regions) == set(REGIONS)
    every = np.concatenate(list(template.regions.values()))
    assert np.array_equal(np.sort(every), np.arange(len(template.mesh.vertices)))
    for name in ("lips", "eyes"):
        near = cKDTree(neutral_mesh().vertices[regions()[name]])
        found = template.mesh.vertices[template.regions[name]]
        assert near.query(found)[0].max() < 2.2


def test_people_and_the_detectors_points_are_where_they_are_on_the_grid(
    template: Template, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, mesh = load_template(default_template_path()), template.mesh
    assert kept.face_points is not None
    assert template.face_points is not None
    assert kept.population is not None
    assert template.population is not None
    pairs = (
        (kept.face_points.on(kept.mesh.vertices), template.face_points.on(mesh.vertices)),
        (
            kept.population.face_points.on(kept.population.mean_mm),
            template.population.face_points.on(template.population.mean_mm),
        ),
    )
    for before, after in pairs:
        assert np.array_equal(np.isnan(before), np.isnan(after))
        away = np.linalg.norm(before - after, axis=1)
        with capsys.disabled():
            print(f"\npoints: {np.nanmean(away):.3f} mm, at most {np.nanmax(away):.2f}", end="")
        assert np.nanmean(away) < 0.05
        assert np.nanmax(away) < 1.0
    assert from_grid_mm(kept.population.mean_mm).mean() < 0.03
    assert template.population.identity_mm.shape[0] == kept.population.identity_mm.shape[0]


def test_the_command_writes_a_folder_that_reads_as_it_was_made(
    tmp_path, template: Template, run_command
) -> None:
    out = tmp_path / "T"
    for _ in range(2):
        assert run_command("sim", "template", "--loops", "--out", out).code == 0
        read = load_template(out)
        assert read.name == "lightstage parametric head, layout 2, loops"
        assert read.mesh.faces.tolist() == template.mesh.faces.tolist()
        assert np.array_equal(read.landmarks, template.landmarks)
        assert read.depth_ratio == template.depth_ratio
        assert set(read.maps) == {"shininess", "translucency"}
        assert (out / "maps" / "skin.png").is_file()
        assert read.face_points is not None
        assert read.population is not None
        assert read.population.face_points is not None
    # The grid's files would be beside people of another topology.
    ended = run_command("sim", "template", "--out", out)
    assert ended.code == 2
    assert "mediapipe468.json" in ended.err


def test_people_of_another_topology_are_not_carried(
    tmp_path, template: Template, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_template(template, tmp_path)
    monkeypatch.setattr(loops_template, "default_template_path", lambda: tmp_path)
    with pytest.raises(SimError, match="vertices of another topology"):
        build_loops_template()


@given(
    st.lists(st.tuples(st.floats(0, ROWS), st.floats(0, COLUMNS)), min_size=1, max_size=8),
    st.sampled_from([(), EYE_CREASES, (83, 84, 85)]),
)
def test_interpolation_is_exact_for_planes_and_at_the_grids_points(places, creases) -> None:
    at = np.array(places)
    at = np.concatenate([at, np.round(at)])
    plain = np.stack(np.meshgrid(np.arange(ROWS + 1), np.arange(COLUMNS + 1), indexing="ij"), -1)
    weights = point_weights(at, creases)
    assert np.abs(weights @ plain.reshape(-1, 2) - at).max() < 1e-9
    noise = np.random.default_rng(0).normal(size=(ROWS + 1, COLUMNS + 1))
    found = (weights @ noise.ravel())[len(places) :]
    row, column = at[len(places) :].astype(int).T
    assert np.abs(found - noise[row, column]).max() < 1e-9


def test_an_edge_of_the_surface_stays_an_edge() -> None:
    rows = np.abs(np.arange(ROWS + 1.0) - 84)
    grid = np.repeat(rows[:, None], COLUMNS + 1, axis=1).ravel()
    at = np.stack([np.linspace(80, 88, 33), np.full(33, 50.5)], axis=1)
    assert np.abs(point_weights(at, (84,)) @ grid - np.abs(at[:, 0] - 84)).max() < 1e-9
    assert np.abs(point_weights(at, ()) @ grid - np.abs(at[:, 0] - 84)).max() > 0.05
