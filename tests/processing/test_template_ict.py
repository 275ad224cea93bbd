"""`template import-ict`: ICT's clone becomes a template that registration and inference take."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pytest

from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.landmarks import write_points_mm
from lightstage.formats.mesh import Mesh, read_obj, write_obj
from lightstage.formats.template import default_template_path, load_template
from processing.atlas.raster import overlap_share, rasterise
from processing.atlas.skin import skin_vertices
from processing.template.build import write_template
from processing.template.config import ImportConfig
from processing.template.ict import read_ict
from processing.template.import_ict import import_ict

FACE = 9409
"""Vertices of ICT's face, the first of its mesh."""


@pytest.fixture(scope="module")
def clone(head_data):
    return head_data / "ict_facekit"


@pytest.fixture(scope="module")
def model(clone):
    return read_ict(clone)


@pytest.fixture(scope="module")
def folder(clone, model, tmp_path_factory):
    config = ImportConfig()
    with pytest.MonkeyPatch.context() as patch:
        # A clone takes seconds to read.
        patch.setattr("processing.template.import_ict.read_ict", {clone: model}.__getitem__)
        template, facts = import_ict(clone, config)
    assert facts["unit"] == "cm"
    assert facts["passed_over"] == []
    return write_template(template, tmp_path_factory.mktemp("ict") / "T", config)


@pytest.fixture(scope="module")
def made(folder):
    return load_template(folder)


def test_the_face_has_the_square_tile_and_the_head_the_rest(made, model):
    mesh = made.mesh
    # ICT's own order of vertices: the face first.
    of_face = (mesh.faces.max(axis=1) < FACE)[:, None] & (mesh.face_uvs >= 0)
    face = mesh.uvs[mesh.face_uvs[of_face]]
    theirs = model.mesh.faces.max(axis=1) < FACE
    own = model.mesh.uvs[model.mesh.face_uvs[theirs]][model.mesh.faces[theirs] >= 0]
    assert len(face) == len(own)
    np.testing.assert_allclose(face * [1, 1.5] - [0, 0.5], own, atol=1e-6)
    rest = mesh.uvs[mesh.face_uvs[~of_face & (mesh.face_uvs >= 0)]]
    assert rest.min() >= 0
    assert rest[:, 1].max() < 1 / 3
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), 768, 512)
    assert overlap_share(mesh.uvs, mesh.triangle_uvs(), raster) < 0.001
    assert (raster.face >= 0).mean() > 0.75


def test_lengths_are_mm_in_the_axes_of_our_own_template(made):
    marks = made.mesh.vertices[made.landmarks]
    own = load_template(default_template_path())
    away = np.linalg.norm(marks - own.mesh.vertices[own.landmarks], axis=1)
    assert np.median(away) < 8
    right_eye, left_eye = marks[36:42].mean(axis=0), marks[42:48].mean(axis=0)
    assert 58 < np.linalg.norm(left_eye - right_eye) < 72
    np.testing.assert_allclose(made.mesh.vertices[:FACE, 0].mean(), 0, atol=1)
    # The nose's bridge is at the origin's height, the tip of the nose is foremost.
    assert abs(marks[27, 1]) < 8
    assert marks[30, 2] > made.mesh.vertices[:, 2].max() - 1


def test_modes_are_icts_meshes_minus_its_mean_in_mm(made, model, clone):
    names = tuple(sorted(p.stem for p in (clone / "FaceXModel").glob("*.obj")
                         if not p.stem.startswith(("identity", "generic"))))  # fmt: skip
    assert made.modes.expression_names == names
    assert "jawOpen" in names
    # Lengths do not depend on the axes; ICT's are cm.
    theirs = 10 * np.linalg.norm(model.identity[:, :FACE], axis=2)
    ours = np.linalg.norm(made.modes.identity[:, :FACE], axis=2)
    np.testing.assert_allclose(ours, theirs, atol=1e-3)
    jaw = made.modes.expression[names.index("jawOpen")]
    assert jaw[made.landmarks[8], 1] < -15  # the chin falls
    blink = made.modes.expression[names.index("eyeBlink_L")]
    assert np.abs(blink[made.landmarks[42:48]]).max() > 4  # the person's left eye
    assert np.abs(blink[made.landmarks[36:42]]).max() < 1
    modes_file = clone / "ict_facekit_modes.npz"
    with np.load(modes_file) as file:
        all_modes = file["identity_modes_cm"][:6, :FACE].astype(float)
    np.testing.assert_allclose(ours, 10 * np.linalg.norm(all_modes, axis=2), atol=0.05)


def test_regions_are_where_they_are_on_a_face(made):
    vertices, marks = made.mesh.vertices, made.mesh.vertices[made.landmarks]
    where = {name: vertices[some] for name, some in made.regions.items()}
    assert all(len(some) > 100 for some in where.values())
    lips = where["lips"]
    assert np.abs(lips.mean(axis=0) - marks[48:].mean(axis=0))[:2].max() < 6
    assert np.abs(where["ears"][:, 0]).min() > 50
    assert np.quantile(np.abs(where["ears"][:, 0]), 0.9) > 80
    eyes = where["eyes"]
    assert np.abs(np.abs(eyes[:, 0]) - 31).max() < 16
    assert len(made.regions["eyes"]) == 2 * 770
    assert where["hair"][:, 1].mean() > 30
    everywhere = np.concatenate(list(made.regions.values()))
    assert len(np.unique(everywhere)) == len(everywhere)
    # What shows skin on everybody: no eyes, no inside of the mouth, no ears.
    skin = skin_vertices(made, 2.0)
    assert 0.3 < skin.mean() < 0.6
    assert not skin[made.regions["eyes"]].any()
    assert skin[made.landmarks[30]]


def test_maps_and_fields_state_what_it_is_made_of(made, folder):
    assert made.licence == "MIT"
    assert "ICT" in made.source
    assert made.name.startswith("ICT")
    assert made.maps["shininess"].shape == made.maps["translucency"].shape == (768, 512)
    skin = cv2.imread(str(folder / "maps" / "skin.png"), cv2.IMREAD_GRAYSCALE)
    assert set(np.unique(skin)) == {0, 255}
    u, v = made.mesh.uvs[made.mesh.face_uvs[made.mesh.faces == made.landmarks[30]][0]]
    at = int((1 - v) * 768), int(u * 512)
    assert skin[at] == 255
    assert made.maps["shininess"][at] == pytest.approx(24, abs=1)
    ball = made.mesh.face_uvs[made.mesh.faces == made.regions["eyes"][300]][0]
    at = int((1 - made.mesh.uvs[ball, 1]) * 768), int(made.mesh.uvs[ball, 0] * 512)
    assert skin[at] == 0
    assert made.maps["shininess"][at] > 100


def quick(tmp_path):
    """A rough registration."""
    path = tmp_path / "quick.toml"
    path.write_text("[register.nonrigid]\nstiffness_mm = [40.0, 10.0]\nmend_rounds = 0\n"
                    "unfold_rounds = 0\n[register.ears]\nsought = false\n")  # fmt: skip
    return path


def test_register_mesh_lays_it_onto_another_of_icts_people(made, folder, tmp_path, run_command):
    # A person within the modes and a little beside them, scanned without eyes and neck.
    rng = np.random.default_rng(1)
    person = made.mesh.vertices + np.tensordot(rng.normal(size=6), made.modes.identity, axes=1)
    person = person + np.array([40.0, 900.0, -200.0])
    triangles = made.mesh.triangles()
    triangles = triangles[(triangles < FACE).all(axis=1)]
    scan = write_obj(Mesh(person[:FACE], triangles), tmp_path / "scan.obj")
    marks = write_points_mm(person[made.landmarks], tmp_path / "L.json")
    config = quick(tmp_path)
    out = tmp_path / "M.obj"
    ended = run_command(
        "processing", "register-mesh", scan, "--landmarks", marks, "--template", folder,
        "--config", config, "--out", out, "--json",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    found = read_obj(out)
    np.testing.assert_array_equal(found.faces, made.mesh.faces)
    np.testing.assert_allclose(found.uvs, made.mesh.uvs, atol=1e-7)
    away = np.linalg.norm(found.vertices - person, axis=1)
    assert np.median(away[:FACE]) < 0.5
    # Eyeballs, which the scan does not show, go with the face.
    assert np.median(away[made.regions["eyes"]]) < 2.5


def test_maps_of_our_own_texture_go_to_icts(made, folder, tmp_path, run_command):
    own = load_template(default_template_path())
    raster = rasterise(own.mesh.uvs, own.mesh.triangle_uvs(), 384, 256)
    image = np.zeros((raster.face.size, 3), np.float32)
    image[raster.texels()] = raster.at(own.mesh.vertices, own.mesh.triangles())
    maps = tmp_path / "maps"
    write_exr(maps / "position.exr", image.reshape(384, 256, 3), half=False)
    out = tmp_path / "out"
    ended = run_command(
        "processing", "template", "transfer", maps, "--from", default_template_path(),
        "--to", folder, "--out", out, "--config", quick(tmp_path),
    )  # fmt: skip
    assert ended.code == 0, ended.err
    there = read_exr(out / "position.exr")
    mask = cv2.imread(str(out / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    # The same places of a face: brows, nose, the outer lips.
    marks = [*range(17, 36), *range(48, 60)]
    corner = [made.mesh.face_uvs[made.mesh.faces == made.landmarks[k]][0] for k in marks]
    u, v = made.mesh.uvs[corner].T
    at = ((1 - v) * 384).astype(int), (u * 256).astype(int)
    # So rough a fit misses some of the nostrils and the corners of the mouth.
    assert mask[at].mean() > 0.8
    away = np.linalg.norm(there[at] - own.mesh.vertices[own.landmarks[marks]], axis=1)[mask[at]]
    assert np.median(away) < 3
    # Our template has no eyeballs: theirs are masked, but for what lies on our closed lids.
    eyes = np.isin(made.mesh.triangles(), made.regions["eyes"]).all(axis=1)
    raster = rasterise(made.mesh.uvs, made.mesh.triangle_uvs(), 384, 256)
    assert mask[(raster.face >= 0) & eyes[raster.face]].mean() < 0.4
    # And the person in ICT's topology, as our template is.
    other = read_obj(out / "registered_mesh.obj")
    np.testing.assert_array_equal(other.faces, made.mesh.faces)


def copied(clone, tmp_path):
    """A clone without most of its shapes."""
    out = tmp_path / "clone"
    (out / "FaceXModel").mkdir(parents=True)
    for name in ("generic_neutral_mesh.obj", "vertex_indices.json", "identity003.obj"):
        shutil.copy(clone / "FaceXModel" / name, out / "FaceXModel" / name)
    return out


def test_a_clone_that_lacks_something_is_named(clone, tmp_path, run_command):
    def ended(path, *words):
        out = tmp_path / "T"
        found = run_command("processing", "template", "import-ict", path, "--out", out, *words)
        assert found.code == 2
        assert not out.exists()
        assert "Traceback" not in found.err
        return found.err

    assert "no such folder" in ended(tmp_path / "nowhere")
    assert "import-obj" in ended(default_template_path())
    whole = copied(clone, tmp_path)
    model = whole / "FaceXModel"
    index = json.loads((model / "vertex_indices.json").read_text())
    (model / "vertex_indices.json").unlink()
    assert "vertex_indices.json" in ended(whole)
    for marks, message in (
        (index["idx_to_landmark_verts"][:67], "67 entries"),
        ([*index["idx_to_landmark_verts"][:67], 10**6], "26719 vertices"),
        (None, "68 vertex indices"),
    ):
        value = {**index, "idx_to_landmark_verts": marks}
        (model / "vertex_indices.json").write_text(json.dumps(value))
        assert message in ended(whole), message
    (model / "vertex_indices.json").write_text(json.dumps(index))
    assert "times as large" in ended(whole, "--unit", "mm")
    lines = (model / "identity003.obj").read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("v "))
    for changed, message in (
        ([*lines[:first], "v nan 0 0", *lines[first + 1 :]], "NaN"),
        ([*lines[:first], *lines[first + 1 :]], "of the same release"),
    ):
        (model / "identity003.obj").write_text("\n".join(changed))
        assert message in ended(whole), message
    (model / "identity003.obj").unlink()
    text = (model / "generic_neutral_mesh.obj").read_text()
    (model / "generic_neutral_mesh.obj").write_text(text.replace("M_ScleraLeft", "other"))
    assert "M_ScleraLeft" in ended(whole)
