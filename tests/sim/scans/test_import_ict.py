"""ICT Face Model Light: read from either source, plausible people, broken copies named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lightstage.errors import LightstageError
from lightstage.formats.mesh import Mesh, vertex_normals, write_obj
from sim.camera.chart import chart_reflectance
from sim.errors import SimError
from sim.head.mesh import grid_places, landmarks, neutral_mesh
from sim.head.modes import EXPRESSIONS
from sim.light.texture import raster_uv
from sim.people.subjects import load_subject
from sim.scans.checks import outward_share
from sim.scans.ict import load_ict
from sim.scans.ict_match import head_from_ict, own_grid_uv_of
from sim.scans.ict_subject import BLENDS, blend, ict_subject, over_eyeballs
from sim.scans.ict_tile import BACK, EYE_SOCKETS, FACE, LEFT_EYE, MOUTH_SOCKET, RIGHT_EYE, parts_of

ROWS = 144


@pytest.fixture(scope="module")
def ict(head_data) -> Path:
    return head_data / "ict_facekit"


@pytest.fixture(scope="module")
def model(ict):
    return load_ict(ict)


@pytest.fixture(scope="module")
def person(ict):
    return ict_subject("ict-5", ict, 5, "neutral", ROWS)


def test_the_clone_and_the_modes_file_hold_the_same_model(ict, model):
    clone = load_ict(ict / "FaceXModel")
    assert model.identity.shape[0] == 100
    assert clone.identity.shape[0] == 6
    np.testing.assert_allclose(clone.mesh.vertices, model.mesh.vertices, atol=1e-4)
    np.testing.assert_array_equal(clone.mesh.faces, model.mesh.faces)
    # Half floats round to about 5 micrometres.
    np.testing.assert_allclose(clone.identity, model.identity[:6], atol=0.01)
    for name, offset in clone.expression.items():
        np.testing.assert_allclose(offset, model.expression[name], atol=0.03)
    assert load_ict(ict) is model
    assert load_ict(ict / "ict_facekit_modes.npz") is model


def test_all_parts_share_one_tile_without_overlap(model):
    parts = parts_of(model)
    assert parts.uvs.min() >= 0
    assert parts.uvs.max() <= 1
    covered = np.zeros((384, 256), int)
    for part in range(8):
        chosen = parts.part == part
        piece = Mesh(
            np.zeros((len(parts.vertices), 3)),
            parts.faces[chosen],
            parts.uvs,
            parts.face_uvs[chosen],
        )
        covered += raster_uv(piece, 384, 256)[0] >= 0
    assert covered.max() == 1
    assert covered.mean() > 0.8
    # The face's tile is square at 6144 x 4096: the upper two thirds.
    face = parts.uvs[np.unique(parts.face_uvs[parts.part == FACE])]
    behind = parts.uvs[np.unique(parts.face_uvs[parts.part == BACK])]
    assert face[:, 1].min() > 1 / 3 > behind[:, 1].max()


def test_people_have_the_sizes_of_people(model):
    rng = np.random.default_rng(0)
    draws = np.clip(rng.normal(size=(200, 100)), -2, 2)
    marks = model.mesh.vertices[model.landmarks]
    marks = marks + np.tensordot(draws, model.identity[:, model.landmarks], axes=1)

    def between(a, b):
        apart = np.linalg.norm(marks[:, a] - marks[:, b], axis=1)
        return apart.mean(), apart.std()

    # Adults [Farkas1994]: biocular 84 to 92, mouth 48 to 55, nasion to chin 110 to 125 mm.
    for pair, low, high, spread in (
        ((36, 45), 82, 94, 6),
        ((48, 54), 46, 57, 6),
        ((27, 8), 105, 127, 9),
    ):
        mean, deviation = between(*pair)
        assert low < mean < high
        assert 1.5 < deviation < spread


def test_a_person_sits_upright_in_the_stage_with_all_maps(person):
    assert person.diffuse_albedo.shape == (ROWS, ROWS * 2 // 3, 3)
    turn, shift = person.head_from_world[:, :3], person.head_from_world[:, 3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    there = person.landmarks_mm @ turn.T + shift
    wanted = neutral_mesh().vertices[landmarks()]
    # Bounds a third beyond what this person has.
    assert np.linalg.norm(there - wanted, axis=1).mean() < 11.4
    assert np.linalg.norm(person.landmarks_mm.mean(axis=0)) < 16.8
    assert (
        58
        < np.linalg.norm(person.landmarks_mm[36:42].mean(0) - person.landmarks_mm[42:48].mean(0))
        < 72
    )
    # From the pupils to the whites of the eyes; skin is between a chart's two patches of skin.
    assert 0.003 < person.diffuse_albedo.min() < 0.0054
    assert 0.55 < person.diffuse_albedo.max() < 0.83
    luminance = np.array([0.2126, 0.7152, 0.0722])
    dark, light = chart_reflectance()[:2] @ luminance
    assert dark < np.median(person.diffuse_albedo[person.skin] @ luminance) < light
    assert 0.5 < person.skin.mean() < 0.63
    assert "USC" in person.source
    face, _ = raster_uv(person.mesh, ROWS, ROWS * 2 // 3)
    length = np.linalg.norm(person.normal, axis=-1)
    np.testing.assert_allclose(length[face >= 0], 1, atol=1e-3)


def test_the_same_seed_is_the_same_person_in_every_expression(ict, person):
    again = ict_subject("ict-5", ict, 5, "smile", ROWS)
    np.testing.assert_array_equal(again.diffuse_albedo, person.diffuse_albedo)
    np.testing.assert_array_equal(again.head_from_world, person.head_from_world)
    moved = np.linalg.norm(again.mesh.vertices - person.mesh.vertices, axis=1)
    assert moved.max() > 4
    assert np.median(moved) < 1


def test_expressions_do_what_their_names_say(model):
    marks = model.landmarks
    rest = model.mesh.vertices[marks]

    def moved(name):
        return blend(model, name)[marks]

    def eye(points):
        return np.linalg.norm(points[37] - points[41])

    assert set(BLENDS) == set(EXPRESSIONS)
    assert not blend(model, "neutral").any()
    smile = moved("smile")
    assert smile[48, 0] < -2
    assert smile[54, 0] > 2
    assert smile[48, 1] > 2
    assert moved("jaw_open")[57, 1] < -10
    assert (moved("brow_raise")[17:27, 1] > 1).all()
    assert (moved("brow_furrow")[19:25, 1] < -0.5).all()
    pucker = moved("pucker")
    assert pucker[48, 0] > 2 > -2 > pucker[54, 0]
    assert eye(rest + moved("eyes_closed")) < 0.25 * eye(rest)
    # Whoever it is, the lids meet.
    rng = np.random.default_rng(3)
    for _ in range(5):
        weights = np.clip(rng.normal(size=100), -2, 2)
        face = model.mesh.vertices + np.tensordot(weights, model.identity, axes=1)
        closed = (face + blend(model, "eyes_closed", face))[marks]
        assert eye(closed) < 0.3 * eye(face[marks])
    with pytest.raises(SimError, match=r"expression: found 'wink', expected neutral, smile"):
        blend(model, "wink")


def test_closing_lids_slide_over_the_cornea_of_any_eye(model):
    parts = parts_of(model)
    rng = np.random.default_rng(3)
    for _ in range(4):
        weights = np.clip(rng.normal(size=100), -2, 2)
        face = model.mesh.vertices + np.tensordot(weights, model.identity, axes=1)
        shut = face + blend(model, "eyes_closed", face)
        kept = over_eyeballs(shut, face, model)
        np.testing.assert_array_equal(over_eyeballs(face, face, model), face)
        assert np.linalg.norm(kept - shut, axis=1).max() < 5
        for eye, lids in ((RIGHT_EYE, (37, 38)), (LEFT_EYE, (43, 44))):
            corners = parts.faces[parts.part == eye]
            ball = kept[parts.vertices[np.unique(corners[corners >= 0])]]
            centre = (ball.min(axis=0) + ball.max(axis=0)) / 2
            for lid in kept[model.landmarks[list(lids)]]:
                toward = (lid - centre) / np.linalg.norm(lid - centre)
                beside = (ball - centre) @ toward > 0.99 * np.linalg.norm(ball - centre, axis=1)
                assert ((ball - centre)[beside] @ toward).max() < np.linalg.norm(lid - centre)


def mean_mesh(model) -> Mesh:
    """The mean face as a subject's mesh, head frame, mm."""
    parts = parts_of(model)
    motion = head_from_ict(model.mesh.vertices, model)
    return parts.mesh((model.mesh.vertices @ motion[:, :3].T + motion[:, 3])[parts.vertices])


def test_each_places_skin_is_that_of_the_same_place_on_our_head(model):
    uv, covered = own_grid_uv_of(model, ROWS)
    parts = parts_of(model)
    face, _ = raster_uv(mean_mesh(model), ROWS, ROWS * 2 // 3)
    skin = np.isin(parts.triangle_parts(), (FACE, BACK))[np.maximum(face, 0)] & (face >= 0)
    np.testing.assert_array_equal(covered, skin)
    assert uv[covered].min() >= 0
    assert uv[covered].max() <= 1
    # Texels at ICT's landmarks lead to our own landmarks.
    own = neutral_mesh()
    where = np.full((len(own.vertices), 2), np.nan)
    where[own.triangles().ravel()] = grid_places()[own.triangle_uvs().ravel()]
    ours = where[landmarks()]
    vertex_uv = np.full((len(model.mesh.vertices), 2), np.nan)
    real = parts.faces >= 0
    chosen = real & (parts.part == FACE)[:, None]
    vertex_uv[parts.vertices[parts.faces[chosen]]] = parts.uvs[parts.face_uvs[chosen]]
    theirs = vertex_uv[model.landmarks]
    # Jaw, brows, nose and eyes' corners: the lips' inside is a slit in both heads.
    for mark in (*range(3, 14), *range(17, 36), 36, 39, 42, 45):
        column = int(theirs[mark, 0] * (ROWS * 2 // 3))
        row = int((1 - theirs[mark, 1]) * ROWS)
        near = uv[row - 1 : row + 2, column - 1 : column + 2][
            covered[row - 1 : row + 2, column - 1 : column + 2]
        ]
        assert np.linalg.norm(near - ours[mark], axis=1).min() < 0.03


def test_eyes_have_an_iris_in_the_middle_of_a_white_ball(ict, model, person):
    parts = parts_of(model)
    face, _ = raster_uv(person.mesh, ROWS, ROWS * 2 // 3)
    part = np.where(face >= 0, parts.triangle_parts()[np.maximum(face, 0)], -1)
    for eye in (LEFT_EYE, RIGHT_EYE):
        luminance = np.where(part == eye, person.diffuse_albedo.mean(axis=-1), np.nan)
        rows, columns = np.nonzero(part == eye)
        middle = int(rows.mean().round()), int(columns.mean().round())
        assert luminance[middle] < 0.5 * np.nanmedian(luminance)
    mouth = person.diffuse_albedo[np.isin(part, (MOUTH_SOCKET, EYE_SOCKETS))]
    assert (mouth[:, 0] > mouth[:, 2]).all()
    assert not person.skin[part > BACK].any()


def test_skin_and_eyes_look_outward(model):
    parts = parts_of(model)
    mesh = mean_mesh(model)
    for part in (FACE, LEFT_EYE, RIGHT_EYE):
        piece = Mesh(mesh.vertices, mesh.faces[parts.part == part])
        assert outward_share(Mesh(mesh.vertices, piece.triangles())) > 0.8
    normals = vertex_normals(mesh.vertices, mesh.triangles())
    motion = head_from_ict(model.mesh.vertices, model)
    nose = model.mesh.vertices[model.landmarks[30]] @ motion[:, :3].T + motion[:, 3]
    tip = np.linalg.norm(mesh.vertices - nose, axis=1).argmin()
    assert normals[tip, 2] > 0.8


def test_ict_is_a_subject_by_name(head_data, person, monkeypatch, tmp_path):
    monkeypatch.setenv("LIGHTSTAGE_DATA", str(head_data))
    one = load_subject("ict-a", 6, None, 96)
    assert (one.name, one.expression) == ("ict-a", "neutral")
    # Another seed is somebody else.
    assert np.abs(one.landmarks_mm - person.landmarks_mm).max() > 5
    monkeypatch.setenv("LIGHTSTAGE_DATA", str(tmp_path))
    with pytest.raises(SimError, match=r"subject ict: found no ICT Face Model.*import-ict"):
        load_subject("ict", 0)


def test_a_clone_that_lacks_shapes_names_which(ict):
    with pytest.raises(SimError, match=r"expression brow_furrow: found no browDown_L, browDown_R"):
        ict_subject("ict", ict / "FaceXModel", 0, "brow_furrow", 96)
    closed = ict_subject("ict", ict / "FaceXModel", 0, "eyes_closed", 96)
    assert closed.expression == "eyes_closed"


# What follows needs no head data: copies of the model that are broken.


def copy_of(folder: Path, count: int = 5) -> Path:
    """A tiny model in the files' form."""
    rng = np.random.default_rng(0)
    face = folder / "FaceXModel"
    face.mkdir(parents=True)
    faces = np.array([[0, 1, 2, 3], [0, 1, 4, -1]], np.int32)
    mesh = Mesh(rng.random((count, 3)), faces, rng.random((count, 2)), faces)
    for name in ("generic_neutral_mesh", "identity000", "jawOpen"):
        write_obj(mesh.with_vertices(rng.random((count, 3))), face / f"{name}.obj")
    marks = {"idx_to_landmark_verts": [i % count for i in range(68)]}
    (face / "vertex_indices.json").write_text(json.dumps(marks))
    return folder


def write_modes(folder: Path, **changes) -> Path:
    values = {
        "neutral_vertices_cm": np.zeros((5, 3), np.float32),
        "uv": np.zeros((5, 2), np.float32),
        "faces": np.array([[0, 1, 2, 3]], np.int32),
        "faces_uv": np.array([[0, 1, 2, 3]], np.int32),
        "identity_modes_cm": np.zeros((2, 5, 3), np.float16),
        "expression_modes_cm": np.zeros((1, 5, 3), np.float16),
        "expression_names": np.array(["jawOpen"]),
    }
    values.update(changes)
    path = folder / "ict_facekit_modes.npz"
    np.savez(path, **{name: value for name, value in values.items() if value is not None})
    return path


def test_a_small_copy_is_read_in_millimetres(tmp_path):
    folder = copy_of(tmp_path / "clone")
    model = load_ict(folder)
    assert list(model.expression) == ["jawOpen"]
    assert model.identity.shape == (1, 5, 3)
    assert model.mesh.vertices.max() > 3
    with pytest.raises(SimError, match=r"vertices: found 5, expected 26719"):
        parts_of(model)


def test_broken_copies_name_the_file_and_what_is_wrong(tmp_path):
    with pytest.raises(SimError, match=r"no such folder, expected a clone of ICT-FaceKit"):
        load_ict(tmp_path / "absent")
    with pytest.raises(SimError, match=r"found no FaceXModel.*Clone"):
        load_ict(tmp_path)
    folder = copy_of(tmp_path / "clone")
    face = folder / "FaceXModel"
    whole = (face / "jawOpen.obj").read_text()
    (face / "jawOpen.obj").write_text("v 0 0 0\n" + whole)
    with pytest.raises(
        SimError, match=r"jawOpen.obj, vertices: found 6, expected 5, as in generic"
    ):
        load_ict(folder)
    (face / "jawOpen.obj").write_text(whole.replace("v 0.", "v nan", 1))
    with pytest.raises(SimError, match=r"jawOpen.obj.*(NaN|convert)"):
        load_ict(folder)
    (face / "jawOpen.obj").write_text(whole)
    for text, message in (
        ('{"idx_to_landmark_verts": [1, 2]}', "found 2 entries, expected 68"),
        ("{}", "idx_to_landmark_verts: found None, expected 68 vertex indices"),
        (json.dumps({"idx_to_landmark_verts": [True] * 68}), r"found \[True, .*expected 68"),
        ("no json", "vertex_indices.json"),
        (json.dumps({"idx_to_landmark_verts": [99] * 68}), "vertex 99, expected indices below"),
    ):
        (face / "vertex_indices.json").write_text(text)
        with pytest.raises(LightstageError, match=message):
            load_ict(folder)
    (face / "vertex_indices.json").unlink()
    with pytest.raises(LightstageError, match=r"vertex_indices.json: found no such file"):
        load_ict(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"identity_modes_cm": np.zeros((2, 4, 3), np.float16)},
            r"identity_modes_cm: found shape \(2, 4, 3\), expected \(k, 5, 3\): .* has 5 vertices",
        ),
        ({"expression_modes_cm": np.zeros((1, 6, 3), np.float16)}, "expression_modes_cm"),
        ({"expression_names": np.array(["a", "b"])}, "expression_names: found 2, expected 1"),
        ({"identity_modes_cm": np.full((2, 5, 3), np.nan, np.float16)}, "NaN"),
        ({"uv": None}, "modes.npz"),
    ],
)
def test_modes_of_another_count_are_refused(tmp_path, changes, message):
    folder = copy_of(tmp_path / "clone")
    write_modes(folder, **changes)
    with pytest.raises(LightstageError, match=message):
        load_ict(folder)


def test_a_file_that_is_no_archive_is_refused(tmp_path):
    folder = copy_of(tmp_path / "clone")
    (folder / "ict_facekit_modes.npz").write_bytes(b"PK no archive")
    with pytest.raises(LightstageError, match=r"ict_facekit_modes.npz"):
        load_ict(folder)
