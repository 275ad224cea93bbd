"""`template check`: each fault is found where it is, and nothing where there is none."""

from __future__ import annotations

import dataclasses
import json

import cv2
import hypothesis.extra.numpy as arrays
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from scipy.spatial import Delaunay

from lightstage.formats.mesh import Mesh
from lightstage.formats.template import (
    Modes,
    Template,
    default_template_path,
    load_template,
    save_template,
)
from processing.template.check import check_template
from processing.template.config import CheckConfig
from processing.template.mesh_faults import (
    borders,
    crowded_edges,
    not_joined,
    slivers,
    turned_against,
)
from processing.template.uv_faults import islands, mirrored, overlapping, stretch_of

QUICK = CheckConfig(uv_rows=384)


def sheet(columns=5, rows=5, step=10.0):
    """A flat grid that faces +z, its UV the whole tile."""
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    places = np.stack([u.ravel() * step * (columns - 1), v.ravel() * step * (rows - 1)], axis=1)
    at = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    quads = np.stack([each.ravel() for each in (a, b, c, d)], axis=1).astype(np.int32)
    return Mesh(
        np.c_[places, np.zeros(len(places))], quads, np.stack([u.ravel(), v.ravel()], 1), quads
    )


@pytest.fixture(scope="module")
def own():
    return load_template(default_template_path())


@pytest.fixture(scope="module")
def face(own):
    """A small template without faults but its open border: our landmarks, joined to triangles."""
    places = own.mesh.vertices[own.landmarks]
    flat = places[:, :2]
    triangles = Delaunay(flat).simplices.astype(np.int32)
    # What is seen from the side only has no place in this texture and is left out.
    across = flat[triangles]
    area = np.linalg.det(across[:, 1:] - across[:, :1])
    triangles = triangles[area > 0.5]
    uvs = 0.05 + 0.9 * (flat - flat.min(axis=0)) / np.ptp(flat, axis=0)
    mesh = Mesh(places, triangles, uvs, triangles)
    regions = {"skin": np.arange(48), "lips": np.arange(48, 68)}
    return Template("face", mesh, np.arange(68), regions, "CC0", "test")


def names(template, config=QUICK):
    return {each.name for each in check_template(template, config)[0]}


def with_mesh(template, **changed):
    return dataclasses.replace(template, mesh=dataclasses.replace(template.mesh, **changed))


def test_a_square_texel_is_no_stretch_and_a_twofold_one_is_39_degrees():
    # 3:2 texels of a 40 x 60 mm sheet are square.
    square = stretch_of(sheet(5, 7), 600)
    np.testing.assert_allclose(square.angle_deg, 0, atol=1e-4)
    np.testing.assert_allclose(square.texel_mm, 0.1)
    tall = sheet(5, 7)
    tall = tall.with_vertices(tall.vertices * [2, 1, 1])
    found = stretch_of(tall, 600)
    np.testing.assert_allclose(found.angle_deg, np.rad2deg(2 * np.arcsin(1 / 3)))
    np.testing.assert_allclose(found.texel_mm, 0.1 * np.sqrt(2))
    angle, area, texel = found.of(np.ones(len(found.angle_deg), bool), 0.95)
    assert (angle, area, texel) == pytest.approx((38.9424, 1, 0.141421), rel=1e-4)


def test_stretch_agrees_with_singular_values_of_each_triangle():
    rng = np.random.default_rng(0)
    triangles = np.arange(60).reshape(-1, 3).astype(np.int32)
    mesh = Mesh(rng.normal(size=(60, 3)), triangles, rng.random((60, 2)), triangles)
    found = stretch_of(mesh, 300)
    for t, (one, two) in enumerate(zip(mesh.vertices[triangles], mesh.uvs[triangles], strict=True)):
        edges = (one[1:] - one[0]).T
        frame = np.linalg.qr(edges)[0]
        texels = ((two[1:] - two[0]) * [200, 300]).T
        a, b = np.linalg.svd(texels @ np.linalg.inv(frame.T @ edges), compute_uv=False)
        assert found.angle_deg[t] == pytest.approx(np.rad2deg(2 * np.arcsin((a - b) / (a + b))))
        assert found.texel_mm[t] == pytest.approx(1 / np.sqrt(a * b))
        assert found.area_mm2[t] == pytest.approx(abs(np.linalg.det(frame.T @ edges)) / 2)


NUMBERS = st.floats(-1e4, 1e4) | st.sampled_from([0.0, 1e-12, 1e9, -1.0])


@given(
    arrays.arrays(float, (6, 3), elements=NUMBERS),
    arrays.arrays(float, (6, 2), elements=st.floats(0, 1)),
)
def test_any_triangles_give_finite_stretch_or_are_marked(vertices, uvs):
    triangles = np.array([[0, 1, 2], [2, 1, 3], [4, 4, 5]], np.int32)
    mesh = Mesh(vertices, triangles, uvs, triangles)
    with np.errstate(all="ignore"):
        found = stretch_of(mesh, 96)
        over = overlapping(mesh, 96)
        whole, turned, flat = mirrored(mesh)
    assert not np.isfinite(found.angle_deg[2])
    known = np.isfinite(found.angle_deg)
    assert ((found.angle_deg[known] >= 0) & (found.angle_deg[known] <= 180)).all()
    assert (found.texel_mm[known] > 0).all()
    assert 0 <= over[1] <= 1
    assert not over[0][2]
    assert flat[2]
    assert len(whole) == len(turned) == 3


def test_overlaps_are_the_triangles_that_share_texels_and_neighbours_are_none():
    mesh = sheet()
    assert not overlapping(mesh, 300)[0].any()
    assert overlapping(mesh, 300)[1] == 0
    # The last quad is laid over the first one.
    extra = np.array([[0, 0], [0.25, 0], [0.25, 0.25], [0, 0.25]])
    corners = mesh.face_uvs.copy()
    corners[-1] = len(mesh.uvs) + np.arange(4)
    double = dataclasses.replace(mesh, uvs=np.concatenate([mesh.uvs, extra]), face_uvs=corners)
    shared, share = overlapping(double, 300)
    assert set(np.flatnonzero(shared)) == {0, 1, 30, 31}
    assert share == pytest.approx(1 / 15, rel=0.05)


def test_mirrored_islands_and_triangles_turned_over_are_distinguished():
    mesh = sheet()
    whole, over, flat = mirrored(mesh)
    assert not (whole | over | flat).any()
    turned = dataclasses.replace(mesh, uvs=[1, 0] - mesh.uvs * [1, -1])
    whole, over, _ = mirrored(turned)
    assert whole.all()
    assert not over.any()
    # The middle vertex is pulled beyond its neighbour.
    bent = mesh.uvs.copy()
    bent[12] = [0.9, 0.5]
    whole, over, _ = mirrored(dataclasses.replace(mesh, uvs=bent))
    assert not whole.any()
    assert 0 < over.sum() <= 4
    assert np.isin(mesh.triangles()[over], [12]).any(axis=1).all()


def test_islands_are_parts_that_the_texture_joins():
    mesh = sheet()
    assert islands(mesh).max() == 0
    corners = mesh.face_uvs.copy()
    corners[:8] += len(mesh.uvs)  # the lower half, a little moved
    cut = dataclasses.replace(
        mesh, uvs=np.concatenate([mesh.uvs, 0.99 * mesh.uvs]), face_uvs=corners
    )
    assert islands(cut).max() == 1
    # The same places written twice are no cut.
    same = dataclasses.replace(mesh, uvs=np.tile(mesh.uvs, (2, 1)), face_uvs=corners)
    assert islands(same).max() == 0


def test_faults_of_a_surface_are_found_at_their_triangles():
    mesh = sheet()
    triangles, vertices = mesh.triangles(), mesh.vertices
    (edge,) = borders(vertices, triangles)
    assert edge.length_mm == pytest.approx(160)
    np.testing.assert_allclose(edge.middle, [20, 20, 0])
    assert not crowded_edges(triangles).any()
    assert not turned_against(triangles).any()
    assert not slivers(vertices, triangles).any()
    assert not not_joined(vertices, triangles, 1e-3).any()
    fin = np.concatenate([triangles, [[0, 6, 18]]])
    assert crowded_edges(fin)[-1]
    assert 2 <= crowded_edges(fin).sum() <= 4
    over = triangles.copy()
    over[5] = over[5, ::-1]
    assert turned_against(over)[5]
    thin = np.concatenate([triangles, [[0, 1, 2]]])
    assert set(np.flatnonzero(slivers(vertices, thin))) == {len(triangles)}
    hole = triangles[~np.isin(triangles, [12]).any(axis=1)]
    assert [round(each.length_mm) > 0 for each in borders(vertices, hole)] == [True, True]
    # Two halves with vertices of their own along the cut.
    cut = triangles.copy()
    lower = np.arange(len(cut)) < 16
    cut[lower] = np.where(np.isin(cut[lower], np.arange(10, 15)), cut[lower] + 15, cut[lower])
    both = np.concatenate([vertices, vertices[10:15]])
    loose = not_joined(both, cut, 1e-3)
    assert set(np.flatnonzero(loose)) == {*range(10, 15), *range(25, 30)}


def test_a_sound_template_has_no_fault_that_is_not_there(face):
    found = names(face)
    assert found <= {"regions missing", "stretch", "holes"}
    facts = check_template(face, QUICK)[1]
    assert facts["landmarks_median_mm"] < 1e-6
    assert facts["uv_overlap_share"] == 0
    json.dumps(facts)


def faulty(face):
    """Name of a finding to a template that has it."""
    marks = face.landmarks.copy()
    marks[7] = 6
    loose = np.concatenate([face.mesh.vertices, face.mesh.vertices[:1]])
    off = face.landmarks.copy()
    off[0] = 68
    away = face.mesh.vertices.copy()
    away[30] += [0, 0, 60]
    nothing = np.zeros((1, 68, 3))
    across = nothing.copy()
    across[0, 33] = [0, 60, 0]
    lost = np.full((1, 68, 3), np.nan)
    none = np.zeros((0, 68, 3))
    mirror = face.mesh.vertices * [-1, 1, 1]
    flat_uv = np.zeros_like(face.mesh.uvs)
    return {
        "landmarks on one vertex": dataclasses.replace(face, landmarks=marks),
        "landmarks off the surface": dataclasses.replace(
            with_mesh(face, vertices=loose), landmarks=off
        ),
        "unused vertices": with_mesh(face, vertices=loose),
        "landmarks elsewhere": with_mesh(face, vertices=away),
        "landmarks of no face": with_mesh(face, vertices=mirror),
        "landmarks in a plane": with_mesh(face, vertices=face.mesh.vertices * [1, 1, 0]),
        "inside out": with_mesh(
            face, faces=face.mesh.faces[:, ::-1], face_uvs=face.mesh.face_uvs[:, ::-1]
        ),
        "axes": with_mesh(face, vertices=face.mesh.vertices[:, [2, 0, 1]]),
        "size": with_mesh(face, vertices=face.mesh.vertices / 10),
        "mirrored islands": with_mesh(face, uvs=face.mesh.uvs * [-1, 1] + [1, 0]),
        "no UV area": with_mesh(face, uvs=flat_uv),
        "UV overlap": with_mesh(face, uvs=np.abs(face.mesh.uvs - [0.5, 0])),
        "modes that fold": dataclasses.replace(face, modes=Modes(none, across, ("nose_up",))),
        "modes without effect": dataclasses.replace(face, modes=Modes(nothing, none, ())),
        "modes not finite": dataclasses.replace(face, modes=Modes(lost, none, ())),
        "names twice": dataclasses.replace(
            face, modes=Modes(none, np.ones((2, 68, 3)), ("smile", "smile"))
        ),
        "regions unknown": dataclasses.replace(face, regions={"nose": np.arange(3)}),
        "regions overlap": dataclasses.replace(
            face, regions={"skin": np.arange(68), "lips": np.arange(68)}
        ),
        "maps": dataclasses.replace(face, maps={"translucency": np.full((30, 30), 2.0)}),
    }


UNUSABLE = {
    "landmarks off the surface", "landmarks of no face", "landmarks in a plane", "inside out",
    "size", "modes not finite",
}  # fmt: skip


def test_every_fault_is_found_by_its_name(face):
    wrong = {}
    for name, template in faulty(face).items():
        with np.errstate(all="ignore"):
            found = {each.name: each for each in check_template(template, QUICK)[0]}
        if name not in found or (name in UNUSABLE and not found[name].unusable):
            wrong[name] = sorted(found)
    assert wrong == {}
    assert any(each.unusable for each in check_template(faulty(face)["no UV area"], QUICK)[0])


def test_the_command_warns_draws_and_exits_2_only_where_nothing_can_be_done(
    face, tmp_path, run_command
):
    good = save_template(face, tmp_path / "good")
    picture = tmp_path / "P.png"
    ended = run_command("processing", "template", "check", good, "--picture", picture, "--json")
    assert ended.code == 0, ended.err
    assert "warning: regions missing: no eyes, ears, hair" in ended.err
    facts = json.loads(ended.out.splitlines()[-1])
    assert facts["open_borders"] >= 1
    (holes,) = (each for each in check_template(face, QUICK)[0] if each.name == "holes")
    require_in_first_colour(face, holes.triangles, picture)
    bad = save_template(faulty(face)["inside out"], tmp_path / "bad")
    ended = run_command("processing", "template", "check", bad, "--picture", tmp_path / "Q.png")
    assert ended.code == 2
    assert "inside out" in ended.err
    require_in_first_colour(face, holes.triangles, tmp_path / "Q.png")
    ended = run_command("processing", "template", "check", tmp_path)
    assert ended.code == 2
    assert "template.json" in ended.err


def require_in_first_colour(template, triangles, path):
    """A picture shows these triangles, and no others, in the colour of the first finding."""
    from processing.template.picture import COLOURS, ROWS

    image = cv2.imread(str(path))[..., ::-1].astype(float)
    assert image.shape[1] == 5 * ROWS // 3
    # At its middle a triangle shows no edge.
    middle = template.mesh.uvs[template.mesh.triangle_uvs()].mean(axis=1)
    columns, rows = (middle * [ROWS * 2 // 3, -ROWS] + [0, ROWS]).astype(int).T
    near = np.abs(image[rows, columns] - COLOURS[0]).max(axis=1) < 70
    np.testing.assert_array_equal(near, np.isin(np.arange(len(near)), triangles))
    # Beside the texture is the mesh, shaded, from four sides: a third of each is red.
    mesh, side = image[:ROWS, ROWS * 2 // 3 :], ROWS // 2
    red = mesh[..., 0] > 3 * mesh[..., 1:].max(axis=2)
    shares = red.reshape(2, side, 2, side).mean(axis=(1, 3))
    np.testing.assert_allclose(shares, 0.33, atol=0.05)


def test_the_picture_shows_a_fault_in_its_place(face):
    from processing.template.picture import COLOURS, ROWS, draw

    template = faulty(face)["UV overlap"]
    found, _ = check_template(template, QUICK)
    shown = [each for each in found if len(each.triangles)]
    colour = np.array(COLOURS[[each.name for each in shown].index("UV overlap")])
    image = draw(template, found)[:ROWS, : ROWS * 2 // 3].astype(int)
    # Edges are drawn over the faces' colour.
    near = np.abs(image - colour).max(axis=2) < 70
    assert near[:, : ROWS // 3].mean() > 0.2
    assert near[:, ROWS // 3 + 30 :].mean() < 0.05


def test_triangles_that_cut_through_others_are_found_where_they_are(own):
    found, facts = check_template(own, QUICK)
    assert facts["self_intersecting_triangles"] == 0
    assert "self-intersections" not in facts["findings"]
    nose = int(own.landmarks[30])
    vertices = own.mesh.vertices.copy()
    vertices[nose, 2] -= 250  # through the back of the head
    bad = dataclasses.replace(own, mesh=own.mesh.with_vertices(vertices))
    found, facts = check_template(bad, QUICK)
    crossing = next(each for each in found if each.name == "self-intersections")
    assert facts["self_intersecting_triangles"] == len(crossing.triangles)
    around = np.flatnonzero((own.mesh.triangles() == nose).any(axis=1))
    assert np.isin(around, crossing.triangles).sum() > 0.5 * len(around)
    assert len(crossing.triangles) < 400


def test_without_pymeshlab_the_check_reports_what_it_left_out(own, monkeypatch):
    monkeypatch.setattr("processing.template.check.reason_without", lambda: "it is not installed")
    _, facts = check_template(own, QUICK)
    assert facts["not_checked"] == "self-intersections: it is not installed"
    assert "self_intersecting_triangles" not in facts
