"""A template's expressions as morph targets: their names, their axes, what is refused."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning.export.command import export_command
from learning.export.morphs import ARKIT, PHOTO, axes_of, morph_names, morph_parts
from learning.export.source import read_source
from lightstage.commands import quiet
from lightstage.formats.files import write_json
from lightstage.formats.mesh import read_obj, vertex_normals, write_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import (
    Modes,
    Template,
    default_template_path,
    load_template,
    save_template,
)
from tests.learning.export.called import accessor, copied, printed, refusal

SIDES = ("Left", "Right")
ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(
    ("own", "names"),
    [
        ("eyeBlink_L", ("eyeBlinkLeft",)),
        ("jawOpen", ("jawOpen",)),
        ("jaw_open", ("jawOpen",)),
        ("browInnerUp_L", ("browInnerUp",)),
        ("browInnerUp_R", ("browInnerUp",)),
        ("jawLeft", ("jawLeft",)),
        ("jaw_L", ("jawLeft",)),
        ("cheekPuff_R", ("cheekPuff",)),
        ("smile", ("mouthSmileLeft", "mouthSmileRight")),
        ("surprise", ("surprise",)),
        ("PupilDilate_L", ("pupilDilateLeft",)),
        ("nose-left-dilatation", ("noseDilatationLeft",)),
        ("mouth-upward-retraction", ("mouthUpwardRetraction",)),
        ("lower_face_region_000", ()),
    ],
)
def test_expressions_have_arkits_names_or_some_of_its_style(
    own: str, names: tuple[str, ...]
) -> None:
    assert morph_names(own) == names


def test_our_own_templates_expressions_are_arkits_and_add_up_to_themselves() -> None:
    template = load_template(default_template_path())
    assert template.modes is not None
    x_mm = template.mesh.vertices[:, 0]
    names: list[str] = []
    for own, offsets in zip(
        template.modes.expression_names, template.modes.expression, strict=True
    ):
        parts = morph_parts(own, np.asarray(offsets, float), x_mm)
        np.testing.assert_allclose(sum(parts.values()), offsets, atol=1e-6)
        names += parts
        for name, part in parts.items():
            moved = np.linalg.norm(part, axis=1)
            side = (moved * np.sign(x_mm)).sum() / moved.sum()
            expected = 1 if name.endswith("Left") else -1 if name.endswith("Right") else 0
            assert side == pytest.approx(expected, abs=0.15), name
    assert len(set(ARKIT)) == 52
    assert set(names) <= set(ARKIT)
    assert len(names) == len(set(names)) == 11


def test_icts_model_has_all_of_arkits_expressions_but_the_tongue(head_data: Path) -> None:
    with np.load(head_data / "ict_facekit" / "ict_facekit_modes.npz") as file:
        own = [str(name) for name in file["expression_names"]]
    named = {name for each in own for name in morph_names(each)}
    assert set(ARKIT) - named == {"tongueOut"}
    others = {f"{each}{side}" for each in ("pupilDilate", "cheekRaiser") for side in SIDES}
    assert named - set(ARKIT) == others


def test_a_templates_expressions_are_morph_targets_in_metres_and_in_the_meshs_axes(
    person: Path, tmp_path: Path
) -> None:
    folder = copied(person, tmp_path)
    mesh = read_obj(folder.registered_mesh)
    rng = np.random.default_rng(1)
    offsets = rng.normal(size=(3, len(mesh.vertices), 3))
    modes = Modes(
        np.zeros((1, len(mesh.vertices), 3)), offsets, ("jawOpen", "eyeBlink_L", "region_003")
    )
    template = Template("ball", mesh, np.arange(68), {}, "CC0", "test", modes)
    save_template(template, tmp_path / "template")
    # A quarter turn about +z: the head's x is the world's y.
    pose = [[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 5]]
    write_json(folder.head_pose, {"head_from_world": pose})
    words = ("--format", "gltf", "--template", tmp_path / "template", "--json")
    facts = json.loads(
        printed("export", folder.root, "--out", tmp_path / "out", *words).splitlines()[-1]
    )
    assert facts["morph_targets"] == ["jawOpen", "eyeBlinkLeft"]
    assert "region_003" in " ".join(facts["notes"])
    data = (tmp_path / "out" / "head.glb").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    read = (document, data[28 + length :])
    primitive = document["meshes"][0]["primitives"][0]
    assert document["meshes"][0]["extras"]["targetNames"] == ["jawOpen", "eyeBlinkLeft"]
    triangles = accessor(read, primitive["indices"])
    expected = offsets[0] @ np.array(pose)[:, :3] / 1000
    moved = accessor(read, primitive["targets"][0]["POSITION"])
    np.testing.assert_allclose(moved[triangles], expected[mesh.triangles()], atol=1e-6)
    # The open jaw has the normals of its own shape.
    opened = vertex_normals(mesh.vertices + 1000 * expected, mesh.triangles())
    before = accessor(read, primitive["attributes"]["NORMAL"])
    turned = before + accessor(read, primitive["targets"][0]["NORMAL"])
    np.testing.assert_allclose(turned[triangles], opened[mesh.triangles()], atol=1e-5)


@pytest.fixture(scope="module")
def smiling(person: Path, tmp_path_factory: pytest.TempPathFactory) -> ProcessedFolder:
    """A head as a fit of a photograph writes it: maps of a face with an expression, and a neutral.

    The expression bends and turns the surface, by 20 degrees at most.
    """
    folder = copied(person, tmp_path_factory.mktemp("smiling"))
    mesh = read_obj(folder.registered_mesh)
    x, y, z = (mesh.vertices / np.abs(mesh.vertices).max()).T
    bent = np.stack([0.1 * y * z, 0.3 * np.sin(2 * x), 0.1 * x], axis=1)
    offsets = np.abs(mesh.vertices).max() * bent
    write_obj(mesh.with_vertices(mesh.vertices - offsets), folder.neutral_mesh)
    return folder


def test_a_fit_leaves_neutral_and_its_texels_normals_turn_with_the_surface(
    smiling: ProcessedFolder,
) -> None:
    as_photographed = read_source(smiling.root, smiling.registered_mesh)
    neutral = read_source(smiling.root)
    wanted = read_obj(smiling.neutral_mesh).vertices
    np.testing.assert_allclose(neutral.mesh.vertices, wanted, atol=1e-3)
    assert neutral.photo_mm is not None
    moved = neutral.mesh.vertices + neutral.photo_mm
    np.testing.assert_allclose(moved, as_photographed.mesh.vertices, atol=1e-3)
    covered = neutral.covered
    for name in ("specular_normal", "diffuse_normal"):
        # In the head's axes the normals are others, in each texel's frame the same.
        before, after = (
            each.maps[name][covered].astype(float) for each in (as_photographed, neutral)
        )
        turned = np.degrees(np.arccos(np.clip(np.einsum("kc,kc->k", before, after), -1, 1)))
        assert np.median(turned) > 5
        tangent, again = (each.tangent(name)[covered] for each in (as_photographed, neutral))
        assert np.abs(tangent - again).max() < 5e-3
    # A smooth map is the neutral surface's own normal, not the photographed one's.
    own = neutral.raster.at(neutral.normals, neutral.mesh.triangles(), neutral.raster.texels())
    smooth = neutral.maps["diffuse_normal"].reshape(-1, 3)[neutral.raster.texels()].astype(float)
    cosine = np.einsum("kc,kc->k", own, smooth) / np.linalg.norm(own, axis=1)
    assert np.degrees(np.arccos(np.clip(np.quantile(cosine, 0.05), -1, 1))) < 6


@pytest.mark.parametrize(("opens_with", "share"), [(None, 0.0), (PHOTO, 1.0)])
def test_the_photographs_expression_is_a_morph_target_or_the_head_opens_with_it(
    smiling: ProcessedFolder, tmp_path: Path, opens_with: str | None, share: float
) -> None:
    out = tmp_path / "out"
    export_command(
        smiling.root, None, "gltf,obj,page", out, None, None, quiet, opens_with=opens_with
    )
    data = (out / "head.glb").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    mesh, read = document["meshes"][0], (document, data[28 + length :])
    assert mesh["extras"]["targetNames"] == [PHOTO]
    assert mesh["weights"] == [share]
    primitive = mesh["primitives"][0]
    neutral, posed = (read_obj(path) for path in (smiling.neutral_mesh, smiling.registered_mesh))
    triangles = accessor(read, primitive["indices"])
    place = accessor(read, primitive["attributes"]["POSITION"])[triangles]
    np.testing.assert_allclose(1000 * place, neutral.vertices[neutral.triangles()], atol=2e-3)
    moved = place + accessor(read, primitive["targets"][0]["POSITION"])[triangles]
    np.testing.assert_allclose(1000 * moved, posed.vertices[posed.triangles()], atol=2e-3)
    shown = posed if opens_with else neutral
    np.testing.assert_allclose(read_obj(out / "head.obj").vertices, shown.vertices, atol=2e-3)
    assert f'"photo": {share}' in (out / "page.html").read_text()


def test_a_neutral_mesh_of_another_head_is_refused(
    smiling: ProcessedFolder, tmp_path: Path
) -> None:
    folder = copied(smiling.root, tmp_path)
    folder.neutral_mesh.write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n")
    out = tmp_path / "out"
    assert "neutral_mesh.obj: found 3 vertices" in refusal("export", folder.root, "--out", out)


def test_without_a_pose_the_vertices_tell_a_meshs_axes() -> None:
    own = load_template(default_template_path())
    rng = np.random.default_rng(2)
    for turn in (
        Rotation.from_euler("yx", [90, 30], degrees=True),
        Rotation.from_euler("z", -75, degrees=True),
    ):
        person = own.mesh.vertices * [1.05, 0.97, 1.1] + rng.normal(0, 1, own.mesh.vertices.shape)
        turned = own.mesh.with_vertices(turn.inv().apply(person) + np.array([10, 1500, 3]))
        found = Rotation.from_matrix(axes_of(turned, own.mesh))
        assert np.degrees((found * turn.inv()).magnitude()) < 3
        # In the head frame nothing is turned: what remains is the person's shape.
        assert np.array_equal(axes_of(own.mesh.with_vertices(person), own.mesh), np.eye(3))


def test_expressions_are_taken_for_gltf_and_page_alone_and_a_note_says_so(
    person: Path, tmp_path: Path
) -> None:
    words = ("--format", "maps", "--template", ROOT / "lightstage" / "data" / "template", "--json")
    facts = json.loads(
        printed("export", person, "--out", tmp_path / "out", *words).splitlines()[-1]
    )
    assert facts["morph_targets"] == []
    assert any("glTF and page alone" in note for note in facts["notes"])


def test_another_templates_expressions_are_refused(person: Path, tmp_path: Path) -> None:
    words = ("--out", tmp_path / "out", "--template", ROOT / "lightstage" / "data" / "template")
    assert "Give the template that the head was registered to" in refusal("export", person, *words)
    assert not (tmp_path / "out").exists()
