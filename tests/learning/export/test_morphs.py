"""A template's expressions as morph targets: their names, their axes, what is refused."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning.export.morphs import ARKIT, arkit_name, arkit_targets, axes_of
from lightstage.formats.files import write_json
from lightstage.formats.mesh import read_obj, vertex_normals
from lightstage.formats.template import (
    Modes,
    Template,
    default_template_path,
    load_template,
    save_template,
)
from tests.learning.export.called import accessor, copied, printed, refusal

ROOT = Path(__file__).resolve().parents[3]


def test_expressions_have_arkits_names_or_none() -> None:
    assert len(set(ARKIT)) == 52
    assert arkit_name("eyeBlink_L") == "eyeBlinkLeft"
    assert arkit_name("jawOpen") == arkit_name("jaw_open") == "jawOpen"
    assert arkit_name("browInnerUp_L") == arkit_name("browInnerUp_R") == "browInnerUp"
    assert arkit_name("jawLeft") == "jawLeft"
    assert arkit_name("surprise") is None
    assert arkit_name("PupilDilate_L") is None


def test_our_own_templates_expressions_are_arkits_and_add_up_to_themselves() -> None:
    template = load_template(default_template_path())
    assert template.modes is not None
    x_mm = template.mesh.vertices[:, 0]
    names: list[str] = []
    for own, offsets in zip(
        template.modes.expression_names, template.modes.expression, strict=True
    ):
        parts = arkit_targets(own, np.asarray(offsets, float), x_mm)
        np.testing.assert_allclose(sum(parts.values()), offsets, atol=1e-6)
        names += parts
        for name, part in parts.items():
            moved = np.linalg.norm(part, axis=1)
            side = (moved * np.sign(x_mm)).sum() / moved.sum()
            expected = 1 if name.endswith("Left") else -1 if name.endswith("Right") else 0
            assert side == pytest.approx(expected, abs=0.15), name
    assert set(names) <= set(ARKIT)
    assert len(names) == len(set(names)) == 11


def test_icts_model_has_all_of_arkits_expressions_but_the_tongue(head_data: Path) -> None:
    with np.load(head_data / "ict_facekit" / "ict_facekit_modes.npz") as file:
        own = [str(name) for name in file["expression_names"]]
    named = {name for each in own for name in arkit_targets(each, np.zeros((1, 3)), np.zeros(1))}
    assert set(ARKIT) - named == {"tongueOut"}
    lacking = [each for each in own if arkit_name(each) is None]
    assert {each[:-2] for each in lacking} == {"PupilDilate", "cheekRaiser"}


def test_a_templates_expressions_are_morph_targets_in_metres_and_in_the_meshs_axes(
    person: Path, tmp_path: Path
) -> None:
    folder = copied(person, tmp_path)
    mesh = read_obj(folder.registered_mesh)
    rng = np.random.default_rng(1)
    offsets = rng.normal(size=(3, len(mesh.vertices), 3))
    modes = Modes(
        np.zeros((1, len(mesh.vertices), 3)), offsets, ("jawOpen", "eyeBlink_L", "surprise")
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
    assert "surprise" in " ".join(facts["notes"])
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


def test_expressions_are_taken_for_gltf_alone_and_a_note_says_so(
    person: Path, tmp_path: Path
) -> None:
    words = ("--format", "maps", "--template", ROOT / "lightstage" / "data" / "template", "--json")
    facts = json.loads(
        printed("export", person, "--out", tmp_path / "out", *words).splitlines()[-1]
    )
    assert facts["morph_targets"] == []
    assert any("glTF alone" in note for note in facts["notes"])


def test_another_templates_expressions_are_refused(person: Path, tmp_path: Path) -> None:
    words = ("--out", tmp_path / "out", "--template", ROOT / "lightstage" / "data" / "template")
    assert "Give the template that the head was registered to" in refusal("export", person, *words)
    assert not (tmp_path / "out").exists()
