from __future__ import annotations

import base64
import io
import json
import operator
import os
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from learning.export.encode import SPECULAR_WHITE
from learning.export.source import read_source
from learning.render.dielectric import F0
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import read_mesh, read_obj, vertex_normals
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.srgb import linear_from_srgb
from tests.learning.export.called import accessor, copied, printed, refusal

ROOT = Path(__file__).resolve().parents[3]
NPM = ROOT / "build" / "npm"


@pytest.fixture(scope="session")
def glb(exported: Path) -> tuple[dict[str, Any], bytes]:
    """The document and the binary part of head.glb, read by hand."""
    data = (exported / "head.glb").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def picture(glb: tuple[dict[str, Any], bytes], texture: int) -> np.ndarray:
    """An embedded picture, red first, 0..1."""
    document, binary = glb
    image = document["images"][document["textures"][texture]["source"]]
    return decoded(binary, document["bufferViews"][image["bufferView"]])


def decoded(binary: bytes, view: dict[str, int]) -> np.ndarray:
    data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    order = {3: [2, 1, 0], 4: [2, 1, 0, 3]}
    found = found[..., order[found.shape[2]]] if found.ndim == 3 else found
    return np.asarray(found / np.iinfo(found.dtype).max)


def read_png(path: Path) -> np.ndarray:
    data = path.read_bytes()
    return decoded(data, {"byteOffset": 0, "byteLength": len(data)})


def test_a_glb_read_by_trimesh_is_the_mesh_in_metres_with_its_texture_coordinates(
    person: Path, exported: Path
) -> None:
    mesh = read_obj(ProcessedFolder(person).registered_mesh)
    loaded = trimesh.load(io.BytesIO((exported / "head.glb").read_bytes()), file_type="glb")
    (found,) = loaded.geometry.values()
    assert len(found.faces) == len(mesh.triangles())
    assert mesh.uvs is not None
    there = found.vertices[found.faces]
    np.testing.assert_allclose(there, 0.001 * mesh.vertices[mesh.triangles()], atol=1e-7)
    # Trimesh turns glTF's v upward again.
    uv = np.asarray(found.visual.uv)[found.faces]
    np.testing.assert_allclose(uv, mesh.uvs[mesh.triangle_uvs()], atol=1e-6)


def test_the_pictures_of_a_glb_are_the_maps_within_a_step_of_eight_bits(
    person: Path, glb: tuple[dict[str, Any], bytes]
) -> None:
    folder, (document, _) = ProcessedFolder(person), glb
    skin = read_source(person).covered
    material = document["materials"][0]
    rough = material["pbrMetallicRoughness"]
    step = 0.5 / 255 + 1e-6
    base = picture(glb, rough["baseColorTexture"]["index"])
    albedo = folder.read_atlas("diffuse_albedo")[skin].astype(float)
    np.testing.assert_allclose(linear_from_srgb(base[skin]), albedo, atol=2.4 * step)
    packed = picture(glb, rough["metallicRoughnessTexture"]["index"])
    assert material["occlusionTexture"]["index"] == rough["metallicRoughnessTexture"]["index"]
    np.testing.assert_allclose(
        packed[..., 1][skin], np.sqrt(folder.read_atlas("roughness")[skin]), atol=step
    )
    openness = folder.read_atlas("ambient_occlusion")[skin]
    np.testing.assert_allclose(packed[..., 0][skin], openness, atol=step)
    assert not packed[..., 2].any()


def test_the_specular_extension_reflects_the_specular_albedo_and_mirrors_no_more_than_all(
    person: Path, glb: tuple[dict[str, Any], bytes]
) -> None:
    extensions = glb[0]["materials"][0]["extensions"]
    assert extensions["KHR_materials_ior"]["ior"] == 1.4
    fields = extensions["KHR_materials_specular"]
    pixels = picture(glb, fields["specularTexture"]["index"])
    factor = np.array(fields["specularColorFactor"])
    # The extension's own formula: F0 of the index, times colour, at most 1, times specular.
    f0 = np.minimum(F0 * factor * linear_from_srgb(pixels[..., :3]), 1) * pixels[..., 3:]
    skin = read_source(person).covered
    albedo = ProcessedFolder(person).read_atlas("specular_albedo")[skin]
    assert albedo.max() > 2 * F0
    assert albedo.min() < 0.1 * F0
    for k in range(3):
        # A step of the sRGB colour is at most 2.4 / 255 of its white.
        np.testing.assert_allclose(f0[skin][:, k], albedo, atol=0.5 * 2.4 / 255 * F0 * factor[0])
    np.testing.assert_allclose(
        pixels[..., 3][skin], np.minimum(albedo / F0, 1), atol=0.5 / 255 + 1e-6
    )


def test_gltfs_own_frame_turns_the_normal_map_back_into_the_normals_of_the_skin(
    person: Path, glb: tuple[dict[str, Any], bytes]
) -> None:
    document = glb[0]
    primitive = document["meshes"][0]["primitives"][0]
    normal, tangent = (
        accessor(glb, primitive["attributes"][name]).astype(float) for name in ("NORMAL", "TANGENT")
    )
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(tangent[:, :3], axis=1), 1, atol=1e-5)
    triangles = accessor(glb, primitive["indices"])
    source = read_source(person)
    skin = source.covered
    faces = triangles[source.raster.face[skin]]
    second = source.raster.barycentric[skin].astype(float)
    weights = np.column_stack([1 - second.sum(axis=1), second])
    n = np.einsum("kc,kcd->kd", weights, normal[faces])
    t = np.einsum("kc,kcd->kd", weights, tangent[faces][..., :3])
    b = np.cross(n, t) * tangent[faces][:, :1, 3]
    shown = 2 * picture(glb, document["materials"][0]["normalTexture"]["index"])[skin] - 1
    world = shown[:, :1] * t + shown[:, 1:2] * b + shown[:, 2:] * n
    world /= np.linalg.norm(world, axis=1, keepdims=True)
    truth = ProcessedFolder(person).read_atlas("specular_normal")[skin].astype(float)
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    # At the ball's poles, where all columns meet, tangents turn within a triangle.
    place = ProcessedFolder(person).read_atlas("position")[skin]
    some = abs(place[:, 1]) < 0.9 * np.linalg.norm(place, axis=1)
    off = np.degrees(np.arccos(np.clip(np.einsum("kd,kd->k", world, truth)[some], -1, 1)))
    assert off.max() < 0.6


def test_the_sixteen_bit_pictures_are_the_maps_within_a_step(person: Path, exported: Path) -> None:
    folder, skin = ProcessedFolder(person), read_source(person).covered
    step = 1 / 65535

    def stored(name: str) -> np.ndarray:
        return read_png(exported / "maps" / f"{name}.png")[skin]

    def given(name: str) -> np.ndarray:
        return folder.read_atlas(name)[skin].astype(float)

    albedo = given("diffuse_albedo")
    np.testing.assert_allclose(linear_from_srgb(stored("diffuse_albedo")), albedo, atol=2.4 * step)
    shown = SPECULAR_WHITE * stored("specular_albedo")
    np.testing.assert_allclose(shown, given("specular_albedo"), atol=SPECULAR_WHITE * step)
    np.testing.assert_allclose(stored("roughness") ** 2, given("roughness"), atol=2 * step)
    np.testing.assert_allclose(stored("confidence"), given("confidence"), atol=step)
    for name in ("diffuse_albedo", "specular_albedo", "roughness"):
        np.testing.assert_array_equal(
            read_exr(exported / "maps" / f"{name}.exr")[skin], folder.read_atlas(name)[skin]
        )
    tangent = read_exr(exported / "maps" / "normal_specular.exr")[skin]
    np.testing.assert_allclose(2 * stored("normal_specular") - 1, tangent, atol=6e-4)


def test_beside_the_surface_a_picture_shows_the_nearest_skin(person: Path, exported: Path) -> None:
    source = read_source(person)
    beside = ~source.covered
    assert beside.any()
    shown = read_png(exported / "textures" / "base_color.png")
    texels = np.flatnonzero(~beside)
    place = np.array(np.divmod(texels, beside.shape[1])).T
    for row, column in np.argwhere(beside)[:: max(1, int(beside.sum()) // 50)]:
        away = np.abs(place - (row, column)).astype(float)
        near = np.hypot(*away.T)
        nearest = place[near < near.min() + 1.0]
        assert (shown[nearest[:, 0], nearest[:, 1]] == shown[row, column]).all(axis=1).any()


def test_beside_the_surface_both_files_of_a_map_show_the_nearest_skin(
    person: Path, exported: Path
) -> None:
    folder, source = ProcessedFolder(person), read_source(person)
    beside = ~source.covered
    nearest = np.unravel_index(source.nearest[beside], source.size)
    for name in ("diffuse_albedo", "specular_albedo", "roughness", "ambient_occlusion"):
        skin = folder.read_atlas(name)
        found = read_exr(exported / "maps" / f"{name}.exr")
        assert (skin[beside] != skin[nearest]).any()
        np.testing.assert_array_equal(found[beside], skin[nearest])
    openness = read_png(exported / "maps" / "ambient_occlusion.png")
    np.testing.assert_allclose(
        openness, read_exr(exported / "maps" / "ambient_occlusion.exr"), atol=0.5 / 65535 + 1e-7
    )


def test_a_wider_float_map_is_written_within_half_a_step_of_half_floats(
    person: Path, tmp_path: Path
) -> None:
    folder = copied(person, tmp_path)
    wide = np.random.default_rng(2).uniform(0.1, 1, folder.read_atlas("diffuse_albedo").shape)
    write_exr(folder.atlas_path("diffuse_albedo"), wide.astype(np.float32), half=False)
    words = ("--format", "maps", "--out", tmp_path / "out")
    printed("export", folder.root, *words)
    skin = read_source(folder.root).covered
    found = read_exr(tmp_path / "out" / "maps" / "diffuse_albedo.exr")
    np.testing.assert_allclose(found[skin], wide[skin], rtol=2**-11 + 1e-6)


def test_the_obj_is_the_mesh_as_it_was_and_its_material_names_pictures_that_are_there(
    person: Path, exported: Path
) -> None:
    before = read_mesh(ProcessedFolder(person).registered_mesh)
    after = read_mesh(exported / "head.obj")
    np.testing.assert_array_equal(after.faces, before.faces)
    np.testing.assert_allclose(after.vertices, before.vertices, atol=1e-6)
    lines = (exported / "head.mtl").read_text().splitlines()
    named = [line.split()[1] for line in lines if line.startswith(("map_", "norm"))]
    assert len(named) == 4
    assert all((exported / name).is_file() for name in named)
    # A principled shader's level of 1 is twice the reflectance of its index.
    (index,) = (float(line.split()[1]) for line in lines if line.startswith("Ni "))
    assert 2 * ((index - 1) / (index + 1)) ** 2 == pytest.approx(SPECULAR_WHITE)
    text = (exported / "head.obj").read_text()
    assert "mtllib head.mtl" in text
    # The normal map is of these normals; without them programs shade each face flat.
    corners = re.findall(r" (\d+)/\d+/(\d+)", text)
    assert len(corners) == (before.faces >= 0).sum()
    assert all(vertex == normal for vertex, normal in corners)
    written = np.array([line.split()[1:] for line in text.splitlines() if line[:3] == "vn "], float)
    expected = vertex_normals(before.vertices, before.triangles())
    known = np.linalg.norm(expected, axis=1) > 0.5  # not those of no triangle
    np.testing.assert_allclose(written[known], expected[known], atol=1e-6)


def test_the_recipe_names_units_colour_spaces_and_every_file(exported: Path) -> None:
    text = (exported / "README.txt").read_text()
    for path in (exported / "maps").iterdir():
        assert path.stem in text
    for word in ("metres", "mm", "sRGB", "Principled BSDF", "Unreal", "IOR", "Beckmann"):
        assert word in text


def node_validator() -> str | None:
    """Why the official validator cannot run; None where it can."""
    if shutil.which("node") is None:
        return "node is not installed"
    here = {**os.environ, "NODE_PATH": f"{NPM / 'node_modules'}:{os.environ.get('NODE_PATH', '')}"}
    words = ["node", "-e", "require.resolve('gltf-validator')"]
    if subprocess.run(words, env=here, capture_output=True, check=False).returncode:
        return (
            "the package gltf-validator is missing: npm install --prefix build/npm gltf-validator"
        )
    return None


def test_the_official_validator_finds_no_error_and_no_warning(exported: Path) -> None:
    missing = node_validator()
    if missing:
        pytest.skip(missing)
    script = (
        "const fs = require('fs');"
        "require('gltf-validator').validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))"
        ".then(r => console.log(JSON.stringify(r.issues)))"
    )
    here = {**os.environ, "NODE_PATH": f"{NPM / 'node_modules'}:{os.environ.get('NODE_PATH', '')}"}
    ended = subprocess.run(
        ["node", "-e", script, str(exported / "head.glb")],
        env=here,
        capture_output=True,
        check=True,
        text=True,
    )
    issues = json.loads(ended.stdout)
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_maps_without_a_processed_folder_take_the_mesh_that_is_named_and_a_constant_roughness(
    person: Path, tmp_path: Path
) -> None:
    maps = tmp_path / "maps"
    maps.mkdir()
    for name in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal"):
        shutil.copy(ProcessedFolder(person).atlas_path(name), maps)
    words = ("--mesh", ProcessedFolder(person).registered_mesh, "--format", "gltf")
    printed("export", maps, "--out", tmp_path / "out", *words)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["README.txt", "head.glb"]
    data = (tmp_path / "out" / "head.glb").read_bytes()
    material = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])["materials"][0]
    rough = material["pbrMetallicRoughness"]
    assert "metallicRoughnessTexture" not in rough
    # The renderer's exponent of 32: alpha^2 = 2 / 34, and glTF's roughness squared is alpha.
    np.testing.assert_allclose(rough["roughnessFactor"] ** 4, 2 / 34)
    assert "0.243" in (tmp_path / "out" / "README.txt").read_text()


def test_where_roughness_was_not_measured_the_renderers_own_is_exported_and_no_mirror(
    person: Path, tmp_path: Path
) -> None:
    folder = copied(person, tmp_path)
    measured = folder.read_atlas("roughness")
    measured[:, :20] = 0
    folder.write_atlas("roughness", measured)
    expected = np.where(measured > 0, measured, np.sqrt(2 / 34))
    found = read_source(folder.root).maps["roughness"]
    np.testing.assert_allclose(found.astype(float), expected, rtol=1e-3)


def value_of(entry: Any, shown: float) -> float:
    """An input of MaterialX's graph, where pictures show one value."""
    from pxr import UsdShade

    if not entry.HasConnectedSource():
        return float(entry.Get())
    node = UsdShade.Shader(entry.GetConnectedSource()[0].GetPrim())
    kind = node.GetIdAttr().Get().removeprefix("ND_").removesuffix("_float")
    if kind == "image":
        return shown
    first, second = (value_of(node.GetInput(slot), shown) for slot in ("in1", "in2"))
    done = {"multiply": operator.mul, "power": operator.pow, "add": operator.add,
            "subtract": operator.sub, "divide": operator.truediv}  # fmt: skip
    return float(done[kind](first, second))


def test_usd_names_the_inputs_of_both_materials_and_their_pictures(
    person: Path, tmp_path: Path
) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed: pip install -e '.[usd]'")
    from pxr import Usd, UsdGeom, UsdShade

    printed("export", person, "--out", tmp_path / "out", "--format", "usd")
    stage = Usd.Stage.Open(str(tmp_path / "out" / "head.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.001
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/head/mesh"))
    shape = read_obj(ProcessedFolder(person).registered_mesh)
    np.testing.assert_allclose(mesh.GetPointsAttr().Get(), shape.vertices, atol=1e-4)
    preview = UsdShade.Shader(stage.GetPrimAtPath("/head/skin/preview"))
    inputs = {i.GetBaseName(): i for i in preview.GetInputs()}
    assert inputs["ior"].Get() == pytest.approx(1.4)
    assert inputs["useSpecularWorkflow"].Get() == 1
    for name in ("diffuseColor", "specularColor", "roughness", "normal", "occlusion"):
        source = inputs[name].GetConnectedSource()[0]
        file = UsdShade.Shader(source.GetPrim()).GetInput("file").Get()
        assert file.resolvedPath.endswith(".png")
    surface = UsdShade.Shader(stage.GetPrimAtPath("/head/skin/mtlx_surface"))
    assert surface.GetIdAttr().Get() == "ND_standard_surface_surfaceshader"
    connected = {i.GetBaseName() for i in surface.GetInputs() if i.HasConnectedSource()}
    assert {"base_color", "specular_IOR", "specular_roughness", "normal"} <= connected
    # Of each texel the index whose reflectance from in front is the map's; at grazing angles all.
    assert surface.GetInput("specular").Get() == 1
    for shown in (0.0, 0.35, 1.0):
        index = value_of(surface.GetInput("specular_IOR"), shown)
        assert ((index - 1) / (index + 1)) ** 2 == pytest.approx(SPECULAR_WHITE * shown, abs=1e-7)


def test_a_page_holds_mesh_pictures_and_library_and_asks_no_server_for_anything(
    person: Path, tmp_path: Path
) -> None:
    words = ("--format", "page", "--compare", person)
    printed("export", person, "--out", tmp_path / "out", *words)
    text = (tmp_path / "out" / "page.html").read_text()
    assert "MIT License" in text
    assert "three.js 0.187.0" in text
    assert not re.findall(r"<[^>]+ (?:src|href)=", text.split("<script", 1)[0])
    assert not any(mark in text for mark in ("@DATA@", "@THREE@", "@CORE@", "@LICENCE@"))
    data = json.loads(re.findall(r'id="data">(.*?)</script>', text, re.S)[0])
    assert [side["name"] for side in data["sides"]] == ["inferred", "captured"]
    mesh = read_obj(ProcessedFolder(person).registered_mesh)
    place = np.frombuffer(base64.b64decode(data["mesh"]["position"]), "<f4").reshape(-1, 3)
    index = np.frombuffer(base64.b64decode(data["mesh"]["index"]), "<u4").reshape(-1, 3)
    np.testing.assert_allclose(place[index], mesh.vertices[mesh.triangles()] / 1000, atol=1e-6)
    kind, packed = data["sides"][0]["specular"].split(",")
    assert kind == "data:image/png;base64"
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(packed), np.uint8), -1)
    skin = read_source(person).covered
    albedo = ProcessedFolder(person).read_atlas("specular_albedo")[skin]
    np.testing.assert_allclose(pixels[skin][:, 3] / 255, np.minimum(albedo / F0, 1), atol=0.002)
    _, packed = data["sides"][0]["normal"].split(",")
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(packed), np.uint8), -1)
    normal = read_source(person).tangent("specular_normal")[skin]
    # Relief of single texels stays: at half the rows and columns it would be half as high.
    assert np.abs(pixels[skin][:, ::-1] / 127.5 - 1 - normal).mean() < 0.03
    # The element that holds a part is ended by the page alone.
    assert text.count("</script>") == 4


def test_a_comparison_without_a_page_is_refused(person: Path, tmp_path: Path) -> None:
    words = ("--format", "gltf", "--compare", person)
    assert "--compare" in refusal("export", person, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_a_page_that_would_be_too_large_is_refused_and_its_folder_is_not_left(
    person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("learning.export.page.MOST_BYTES", 1_000_000)
    assert "expected at most 1 MB" in refusal(
        "export", person, "--out", tmp_path / "out", "--format", "page"
    )
    assert not list(tmp_path.iterdir())
