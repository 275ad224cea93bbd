"""`template import-obj`: anybody's mesh becomes a template, and what cannot be one is named."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from lightstage.errors import FormatError
from lightstage.formats.files import write_json
from lightstage.formats.landmarks import write_points_mm
from lightstage.formats.mesh import Mesh, write_obj, write_ply
from lightstage.formats.template import default_template_path, load_template
from processing.template.config import ImportConfig
from processing.template.frame import head_from_mesh
from processing.template.packing import packed
from processing.template.regions import guessed_regions
from processing.units import CM, METRES, MM


@pytest.fixture(scope="module")
def own():
    return load_template(default_template_path())


@pytest.fixture(scope="module")
def face(own):
    """Our own landmarks, joined to triangles as they are seen from in front."""
    places = own.mesh.vertices[own.landmarks]
    flat = places[:, :2]
    triangles = Delaunay(flat).simplices.astype(np.int32)
    uvs = (flat - flat.min(axis=0)) / np.ptp(flat, axis=0)
    return Mesh(places, triangles, uvs, triangles)


REGIONS = {"skin": [*range(48)], "lips": [*range(48, 68)], "eyes": [*range(36, 48)]}


@pytest.fixture
def regions(tmp_path):
    return write_json(tmp_path / "regions.json", REGIONS)


def elsewhere(mesh, scale=1.0):
    """A mesh in other axes, at another place and in another unit."""
    turn = Rotation.from_rotvec([1.2, 0.4, -2.0]).as_matrix()
    return mesh.with_vertices(scale * ((mesh.vertices + np.array([30, -1500, 200])) @ turn.T))


def imported(run_command, mesh, marks, out, *words):
    return run_command(
        "processing", "template", "import-obj", mesh, "--landmarks", marks, "--out", out, *words
    )


@pytest.mark.parametrize(("unit", "name"), [(MM, "mm"), (CM, "cm"), (METRES, "m")])
@pytest.mark.parametrize("given", [True, False])
def test_axes_origin_and_unit_of_a_mesh_become_the_head_frame(
    face, regions, tmp_path, run_command, unit, name, given
):
    moved = elsewhere(face, 1 / unit.mm)
    mesh = write_obj(moved, tmp_path / "head.obj")
    marks = write_points_mm(moved.vertices, tmp_path / "L.json")
    words = ["--unit", name] if given else []
    ended = imported(run_command, mesh, marks, tmp_path / "T", "--regions", regions, *words)
    assert ended.code == 0, ended.err
    made = load_template(tmp_path / "T")
    # The OBJ has six digits behind the point, the landmarks four: metres are then 0.05 mm.
    np.testing.assert_allclose(made.mesh.vertices, face.vertices, atol=0.1)
    np.testing.assert_array_equal(made.mesh.faces, face.faces)
    np.testing.assert_allclose(made.mesh.uvs, face.uvs, atol=1e-7)
    np.testing.assert_array_equal(made.landmarks, np.arange(68))
    assert {name: some.tolist() for name, some in made.regions.items()} == REGIONS
    assert made.maps["shininess"].shape == (768, 512)
    # Between skin's and the eyes', and more where lips or eyes are.
    shining = made.maps["shininess"]
    assert 24 <= shining.min() < shining.max() - 20 < 140


def test_vertices_name_landmarks_as_well_as_points(face, regions, tmp_path, run_command):
    mesh = write_obj(face, tmp_path / "head.obj")
    value = {"scheme": "ibug68", "vertices": [*range(68)]}
    marks = write_json(tmp_path / "L.json", value)
    ended = imported(
        run_command, mesh, marks, tmp_path / "T", "--regions", regions, "--licence", "CC0"
    )
    assert ended.code == 0, ended.err
    made = load_template(tmp_path / "T")
    np.testing.assert_array_equal(made.landmarks, np.arange(68))
    assert (made.licence, made.name, made.source) == ("CC0", "head", "head.obj")
    assert made.modes is None


def test_regions_of_a_mesh_without_any_come_from_our_own_template(own):
    # Each vertex at another place along the surface would be in the region of that place.
    taller = own.mesh.with_vertices(own.mesh.vertices * [1.05, 0.96, 1.02])
    found = guessed_regions(taller, own.landmarks, own, ImportConfig())
    for name in ("skin", "lips", "ears", "hair"):
        true = np.isin(np.arange(len(taller.vertices)), own.regions[name])
        guess = np.isin(np.arange(len(taller.vertices)), found[name])
        both = (true & guess).sum() / (true | guess).sum()
        assert both > {"skin": 0.85, "lips": 0.7, "ears": 0.7, "hair": 0.85}[name], (name, both)
    assert sum(len(some) for some in found.values()) == len(np.unique(np.hstack([*found.values()])))


def refusals(mesh, tmp_path):
    """Name to (mesh, landmarks, words, what must be said)."""
    points = mesh.vertices
    marks = write_points_mm(points, tmp_path / "right.json")
    good = write_obj(mesh, tmp_path / "right.obj")

    def obj(name, changed):
        return write_obj(changed, tmp_path / f"{name}.obj")

    def points_of(name, changed):
        return write_points_mm(changed, tmp_path / f"{name}.json")

    def value(name, content):
        return write_json(tmp_path / f"{name}.json", content)

    bare = Mesh(mesh.vertices, mesh.faces)
    far = Mesh(mesh.vertices, mesh.faces, mesh.uvs * [2, 1], mesh.face_uvs)
    holed = points.copy()
    holed[30] = np.nan
    nan = tmp_path / "nan.obj"
    lines = good.read_text().splitlines()
    nan.write_text("\n".join(["v nan 0 0", *lines[1:]]))
    mirror = mesh.with_vertices(mesh.vertices * [-1, 1, 1])
    vertices = [*range(68)]
    return {
        "no UV": (obj("bare", bare), marks, [], "no texture coordinates"),
        "PLY": (write_ply(bare, tmp_path / "bare.ply"), marks, [], "PLY files are read without"),
        "two tiles": (obj("far", far), marks, [], "u from 0"),
        "NaN": (nan, marks, [], "NaN or infinity"),
        "nothing": (tmp_path / "none.obj", marks, [], "none.obj"),
        "mirrored": (
            obj("mirror", mirror),
            points_of("mirror", points * [-1, 1, 1]),
            [],
            "mirror image",
        ),
        "67": (good, value("67", {"scheme": "ibug68", "points_mm": points[1:].tolist()}), [], "67"),
        "null": (good, points_of("null", holed), [], "points_mm[30]"),
        "off": (
            good,
            points_of("off", points + np.array([0, 0, 30])),
            [],
            "from the mesh's nearest vertex",
        ),
        "order": (good, points_of("order", points[::-1]), [], "iBUG's order"),
        "one vertex": (
            good,
            value("one", {"scheme": "ibug68", "vertices": [3] * 68}),
            [],
            "1 different vertices",
        ),
        "beyond": (
            good,
            value("beyond", {"scheme": "ibug68", "vertices": [10**6, *vertices[1:]]}),
            [],
            "vertices[0]: found 1000000, expected a vertex of the mesh, 0 to",
        ),
        "null vertex": (
            good,
            value("hole", {"scheme": "ibug68", "vertices": [*vertices[:-1], None]}),
            [],
            "vertices[67]: found None",
        ),
        "inside out": (
            obj(
                "turned", Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.uvs, mesh.face_uvs[:, ::-1])
            ),
            marks,
            ["--regions", value("all", {"skin": vertices})],
            "turned.obj, faces: found faces that run clockwise",
        ),
        "scheme": (good, value("scheme", {"vertices": vertices}), [], "ibug68"),
        "unit": (good, marks, ["--unit", "cm"], "times as large"),
        "no unit": (good, marks, ["--unit", "inch"], "mm or cm or m"),
        "regions": (good, marks, ["--regions", value("r", {"nose": [1]})], "nose"),
        "region": (good, marks, ["--regions", value("q", {"skin": [-1]})], "vertex indices"),
        "regions no object": (
            good,
            marks,
            ["--regions", value("s", {"regions": 3})],
            "an object",
        ),
    }


def test_what_cannot_be_a_template_is_one_message_and_nothing_is_left(face, tmp_path, run_command):
    wrong = {}
    out = tmp_path / "T"
    for name, (mesh, marks, words, message) in refusals(face, tmp_path).items():
        ended = imported(run_command, mesh, marks, out, *words)
        if ended.code != 2 or message not in ended.err or "Traceback" in ended.err or out.exists():
            wrong[name] = (ended.code, ended.err)
    assert wrong == {}


def test_an_existing_folder_is_replaced_only_where_it_is_a_template_and_asked_for(
    face, regions, tmp_path, run_command
):
    mesh = write_obj(face, tmp_path / "head.obj")
    marks = write_points_mm(face.vertices, tmp_path / "L.json")
    out = tmp_path / "T"
    out.mkdir()
    (out / "letters.txt").write_text("mine")
    words = ["--regions", regions]
    assert imported(run_command, mesh, marks, out, *words, "--overwrite").code == 2
    assert (out / "letters.txt").read_text() == "mine"
    (out / "letters.txt").unlink()
    assert imported(run_command, mesh, marks, out, *words).code == 0
    refused = imported(run_command, mesh, marks, out, *words)
    assert refused.code == 2
    assert "--overwrite" in refused.err
    (out / "letters.txt").write_text("mine")
    refused = imported(run_command, mesh, marks, out, *words, "--overwrite")
    assert refused.code == 2
    assert "found letters.txt, which the command did not make" in refused.err
    (out / "letters.txt").unlink()
    assert imported(run_command, mesh, marks, out, *words, "--overwrite").code == 0


def test_a_template_of_a_newer_schema_is_refused(face, regions, tmp_path, run_command):
    mesh = write_obj(face, tmp_path / "head.obj")
    marks = write_points_mm(face.vertices, tmp_path / "L.json")
    out = tmp_path / "T"
    assert imported(run_command, mesh, marks, out, "--regions", regions).code == 0
    value = json.loads((out / "template.json").read_text())
    write_json(out / "template.json", {**value, "schema": "lightstage.template/2"})
    ended = run_command(
        "processing", "register-mesh", mesh, "--landmarks", marks, "--template", out,
        "--out", tmp_path / "M.obj",
    )  # fmt: skip
    assert ended.code == 2
    assert "newer version" in ended.err


def test_the_smallest_mesh_is_refused_with_a_message(tmp_path, face):
    square = Mesh(
        np.array([[0.0, 0, 0], [90, 0, 0], [90, 90, 0], [0, 90, 0]]),
        np.array([[0, 1, 2, 3]], np.int32),
    )
    marks = np.arange(68) % 4
    with pytest.raises(FormatError, match="4 different vertices"):
        head_from_mesh(square.vertices, marks, face.vertices, MM, tmp_path, ImportConfig())


def test_small_parts_are_packed_beside_the_large_ones_without_overlap(tmp_path):
    # A face that leaves a corner free, a head that leaves its sides free, two small squares.
    face = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    head = np.array([[1.3, 0], [1.7, 0], [1.7, 1], [1.3, 1]])
    eyes = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    uvs = np.concatenate([face, head, eyes, eyes + np.array([4, 0])])
    quads = np.arange(16).reshape(4, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    part = np.tile(np.arange(4), 2)
    out = packed(uvs, triangles, part, np.array([300.0, 300, 30, 30]) ** 2, tmp_path, list("fhlr"))
    assert out.min() >= 0
    assert out.max() <= 1
    np.testing.assert_allclose(out[:4, 1], [1 / 3, 1 / 3, 1, 1])
    low, high = out.reshape(4, 4, 2).min(axis=1), out.reshape(4, 4, 2).max(axis=1)
    for one in range(4):
        for other in range(one):
            apart = (low[one] >= high[other] - 1e-9) | (low[other] >= high[one] - 1e-9)
            assert apart.any(), (one, other)
    # As dense as the face: a tenth of its side.
    np.testing.assert_allclose((high - low)[2] * [1, 1.5], 0.1, atol=0.005)


def test_a_part_whose_uv_lies_in_several_tiles_is_refused(tmp_path):
    uvs = np.array([[0.2, 0], [1.4, 0], [0.2, 1], [1.2, 0.5], [1.5, 0.5], [1.2, 0.9]])
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    with pytest.raises(FormatError, match="uv of face"):
        packed(uvs, triangles, np.array([0, 1]), np.ones(2), tmp_path, ["face", "head"])
