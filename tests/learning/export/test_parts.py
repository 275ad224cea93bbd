"""A fitted head's mouth and eyes: where they are, what they follow, and how they leave."""

from __future__ import annotations

import dataclasses
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning.export.command import export_command
from learning.export.morphs import morph_targets
from learning.export.parts.eyes import COLUMNS, FRONT, look_names
from learning.export.parts.furnish import Furnished, furnished
from learning.export.parts.mouth import PIVOT_MM, jaw_turn
from learning.export.parts.opened import CENTRE_MM, RADIUS_MM, template_lines
from learning.export.source import Source, read_source
from learning.render.uv import rasterise
from lightstage.commands import quiet
from lightstage.formats.mesh import read_mesh, write_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from tests.learning.export.called import accessor

SIDE = 192


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> ProcessedFolder:
    """The template as a fit writes it, with its smile as the photograph's expression."""
    folder = ProcessedFolder(tmp_path_factory.mktemp("fitted") / "fit")
    folder.root.mkdir()
    mesh = template_lines().mesh
    targets, _ = morph_targets(default_template_path(), mesh, np.eye(3, 4))
    smile = targets["mouthSmileLeft"] + targets["mouthSmileRight"]
    shown = mesh.with_vertices(mesh.vertices + smile)
    write_obj(mesh, folder.neutral_mesh)
    write_obj(shown, folder.registered_mesh)
    raster = rasterise(shown, SIDE, SIDE)
    normals = raster.normals(shown)
    folder.write_atlas("position", raster.interpolate(shown.vertices))
    for name in ("diffuse_normal", "specular_normal"):
        folder.write_atlas(name, normals)
    folder.write_atlas("diffuse_albedo", np.full((SIDE, SIDE, 3), (0.1, 0.2, 0.25)))
    folder.write_atlas("specular_albedo", np.full((SIDE, SIDE), 0.03))
    return folder


@pytest.fixture(scope="module")
def source(fitted: ProcessedFolder) -> Source:
    return read_source(fitted.root)


@pytest.fixture(scope="module")
def head(source: Source) -> Furnished:
    targets, _ = morph_targets(default_template_path(), source.mesh, None)
    assert source.photo_mm is not None
    return furnished(source, {**targets, "photo": source.photo_mm})


def test_behind_closed_lips_and_lids_nothing_is_before_the_skin(head: Furnished) -> None:
    mesh = head.source.mesh
    for name, lift in (("upperTeeth", 1.0), ("lowerTeeth", 1.0), ("tongue", 4.0)):
        part = next(each for each in head.parts if each.name == name)
        for place in part.places[::7]:
            near = np.linalg.norm(mesh.vertices[:, :2] - place[:2], axis=1) < 2.5
            outer = mesh.vertices[near, 2]
            assert place[2] < outer.max() - lift, name
    ball = next(each for each in head.parts if each.name == "eyeLeft")
    lids = next(each for each in head.parts if each.name == "lidsLeft")
    edge = lids.places[: len(lids.places) // 3]
    # The white alone is a ball, the cornea bulges: |p|^2 = 2 p c + d, by least squares.
    white = ball.places[FRONT * COLUMNS :]
    terms = np.column_stack([2 * white, np.ones(len(white))])
    centre = np.linalg.lstsq(terms, (white**2).sum(axis=1))[0][:3]
    np.testing.assert_allclose(centre, CENTRE_MM, atol=4.1)
    assert np.quantile(np.linalg.norm(edge - centre, axis=1), 0.05) > RADIUS_MM + 0.4


def test_the_lower_teeth_keep_their_shape_and_fall_with_the_chin_and_the_upper_ones_stay(
    head: Furnished,
) -> None:
    upper, lower = (
        next(each for each in head.parts if each.name == f"{name}Teeth")
        for name in ("upper", "lower")
    )
    assert upper.morphs == {}
    moved = lower.places + lower.morphs["jawOpen"]
    assert lower.morphs["jawOpen"][:, 1].max() < -5
    sides = (np.linalg.norm(each[1:] - each[:-1], axis=1) for each in (lower.places, moved))
    np.testing.assert_allclose(*sides, atol=1e-9)


@pytest.mark.parametrize("degrees", [3.0, 13.0])
def test_the_jaws_angle_is_found_from_a_turned_chin(degrees: float) -> None:
    places = template_lines().mesh.vertices
    turn = Rotation.from_euler("x", degrees, degrees=True)
    offsets = turn.apply(places - PIVOT_MM) + PIVOT_MM - places
    found = np.degrees(jaw_turn(places, offsets, PIVOT_MM).magnitude())
    assert found == pytest.approx(degrees, rel=0.01)


@pytest.mark.parametrize(
    ("look", "axis", "sign"), [("Up", 1, 1), ("Down", 1, -1), ("In", 0, -1), ("Out", 0, 1)]
)
def test_a_look_turns_one_eyes_pupil_the_way_that_it_is_named(
    head: Furnished, look: str, axis: int, sign: int
) -> None:
    for side, mirrored in (("Left", 1), ("Right", -1)):
        ball = next(each for each in head.parts if each.name == f"eye{side}")
        pupil = ball.morphs[f"eyeLook{look}{side}"][0]
        assert pupil[axis] * sign * (mirrored if axis == 0 else 1) > 4
        assert len(ball.morphs) == 4


def test_the_iris_has_the_painted_colour_and_brown_replaces_one_that_is_too_light(
    source: Source, head: Furnished
) -> None:
    def iris(found: Furnished) -> np.ndarray:
        ball = next(each for each in found.parts if each.name == "eyeLeft")
        return np.asarray(ball.colours.reshape(-1, COLUMNS, 3)[28].mean(axis=0))

    blue = iris(head)
    assert blue[2] > 2 * blue[0]
    light = {**source.maps, "diffuse_albedo": np.full((SIDE, SIDE, 3), 0.7, np.float16)}
    brown = iris(furnished(dataclasses.replace(source, maps=light), {}))
    assert brown[0] > 2 * brown[2]


def test_a_captured_head_keeps_its_eyes(source: Source) -> None:
    captured = dataclasses.replace(source, photo_mm=None)
    found = furnished(captured, {})
    assert found.source is captured
    assert found.parts == ()


def test_a_glb_has_the_parts_with_the_skins_morph_targets_and_the_page_has_them_too(
    fitted: ProcessedFolder, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    export_command(fitted.root, None, "gltf,page", out, default_template_path(), None, quiet)
    data = (out / "head.glb").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    mesh, read = document["meshes"][0], (document, data[28 + length :])
    names = mesh["extras"]["targetNames"]
    assert {"jawOpen", "photo", *look_names()} <= set(names)
    materials = [document["materials"][each["material"]]["name"] for each in mesh["primitives"]]
    assert materials[0] == "skin"
    assert {"eyeLeft", "eyeRight", "upperTeeth", "lowerTeeth", "tongue", "mouth"} < set(materials)
    assert all(len(each["targets"]) == len(names) for each in mesh["primitives"])
    teeth = mesh["primitives"][materials.index("lowerTeeth")]
    fall = accessor(read, teeth["targets"][names.index("jawOpen")]["POSITION"])[:, 1]
    assert fall.max() < -0.005
    page = (out / "page.html").read_text()
    written = json.loads(page.split('id="data">')[1].split("</script>")[0])
    assert list(written["morphs"]) == names
    assert len(written["parts"]) == len(materials) - 1


def test_formats_without_morph_targets_have_the_closed_skin_with_the_photographs_expression(
    fitted: ProcessedFolder, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    export_command(fitted.root, None, "gltf,obj", out, None, None, quiet, opens_with="photo")
    written, shown = read_mesh(out / "head.obj"), read_mesh(fitted.registered_mesh)
    np.testing.assert_allclose(written.vertices, shown.vertices, atol=1e-4)
    assert np.array_equal(written.faces, shown.faces)
