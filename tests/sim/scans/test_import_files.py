"""Files that scans come in: glTF and OBJ give the same mesh; damaged ones say where."""

from __future__ import annotations

import base64
import copy
import json

import numpy as np
import pytest

from lightstage.errors import FormatError, LightstageError
from lightstage.formats.exr import write_exr
from lightstage.formats.mesh import Mesh
from sim.errors import SimError
from sim.scans.checks import outward_share
from sim.scans.reading import read_scan
from sim.scans.scan_file import decode_picture, merged, read_picture


def corners(mesh: Mesh) -> np.ndarray:
    """(t, 3, 5) places and UV of all triangles: what a mesh is, whatever its indices."""
    return np.concatenate([mesh.vertices[mesh.faces], mesh.uvs[mesh.face_uvs]], axis=2)


def test_gltf_and_obj_hold_the_same_mesh_and_texture(egg, files, tmp_path):
    png = files["picture_bytes"]()
    scan = read_scan(files["write_glb"](tmp_path / "egg.glb", egg, png))
    assert scan.mm_per_unit == 1000.0
    assert len(scan.mesh.vertices) == len(egg.vertices)
    np.testing.assert_allclose(corners(scan.mesh) * [1e3, 1e3, 1e3, 1, 1], corners(egg), atol=2e-5)
    other = read_scan(files["write_textured_obj"](tmp_path / "egg.obj", egg, png))
    assert other.mm_per_unit is None
    np.testing.assert_allclose(corners(other.mesh), corners(egg), atol=2e-6)
    np.testing.assert_array_equal(scan.colour.pixels, other.colour.pixels)
    assert scan.colour.pixels[0, -1] == pytest.approx(np.array([200, 120, 60]) / 255, abs=1e-6)


def test_a_gltf_in_pieces_is_the_same_scan(egg, files, tmp_path):
    png = files["picture_bytes"]()
    whole = read_scan(files["write_glb"](tmp_path / "egg.glb", egg, png))
    scene, data = files["gltf_scene"](egg.with_vertices(egg.vertices / 1000), png)
    (tmp_path / "egg data.bin").write_bytes(data)
    (tmp_path / "skin.png").write_bytes(png)
    scene["buffers"][0]["uri"] = "egg%20data.bin"
    scene["images"] = [{"uri": "skin.png"}]
    (tmp_path / "apart.gltf").write_text(json.dumps(scene))
    scene["buffers"][0]["uri"] = "data:a/b;base64," + base64.b64encode(data).decode()
    scene["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(png).decode()}]
    (tmp_path / "within.gltf").write_text(json.dumps(scene))
    for name in ("apart.gltf", "within.gltf"):
        found = read_scan(tmp_path / name)
        np.testing.assert_array_equal(found.mesh.vertices, whole.mesh.vertices)
        np.testing.assert_array_equal(found.colour.pixels, whole.colour.pixels)


def test_a_nodes_transforms_move_the_mesh_and_a_mirror_keeps_its_outside(egg, files, tmp_path):
    scene, data = files["gltf_scene"](egg)
    scene["scenes"] = [{"nodes": [1]}]
    half = float(np.sqrt(0.5))
    scene["nodes"] += [{"children": [2], "translation": [1, 2, 3]}]
    scene["nodes"] += [{"children": [0], "rotation": [0, half, 0, half], "scale": [-2, 2, 2]}]
    path = tmp_path / "moved.glb"
    path.write_bytes(files["glb_bytes"](scene, data))
    found = read_scan(path).mesh
    # A quarter turn about +y carries x to -z and z to x.
    flat = egg.vertices[egg.faces[:, ::-1]].reshape(-1, 3) * [-2, 2, 2]
    wanted = np.stack([flat[:, 2] + 1, flat[:, 1] + 2, 3 - flat[:, 0]], axis=1)
    np.testing.assert_allclose(found.vertices[found.faces].reshape(-1, 3), wanted, atol=1e-3)
    assert outward_share(found) > 0.9
    scene["nodes"][0] = {"mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 5, 0, 0, 1]}
    scene["scenes"] = [{"nodes": [0]}]
    path.write_bytes(files["glb_bytes"](scene, data))
    np.testing.assert_allclose(
        np.sort(read_scan(path).mesh.vertices, axis=0),
        np.sort(egg.vertices * 2 + [5, 0, 0], axis=0),
        atol=1e-4,
    )


def test_damaged_gltf_is_reported_by_file_and_field(egg, files, tmp_path):
    scene, data = files["gltf_scene"](egg, files["picture_bytes"]())
    path = tmp_path / "scan.glb"

    def refuse(said, change=None, raw=None):
        changed = copy.deepcopy(scene)
        if change is not None:
            change(changed)
        path.write_bytes(files["glb_bytes"](changed, data) if raw is None else raw)
        with pytest.raises(SimError, match=said) as caught:
            read_scan(path)
        assert "scan.glb" in str(caught.value)

    whole = files["glb_bytes"](scene, data)
    refuse("binary glTF", raw=b"no glb at all, this is text")
    refuse("truncated", raw=whole[: len(whole) // 2])
    refuse("truncated", raw=whole[:15])
    refuse("glTF 1.0, expected glTF 2.0", lambda s: s["asset"].update(version="1.0"))
    refuse(
        "KHR_draco_mesh_compression",
        lambda s: s.update(extensionsRequired=["KHR_draco_mesh_compression"]),
    )
    refuse("no triangles", lambda s: s["nodes"].__setitem__(0, {}))
    refuse("damaged scene", lambda s: s["nodes"].__setitem__(0, {"mesh": 7}))
    refuse("mode 5", lambda s: s["meshes"][0]["primitives"][0].update(mode=5))
    refuse(r"accessors\[0\].*truncated", lambda s: s["accessors"][0].update(count=10**7))
    refuse("sparse", lambda s: s["accessors"][0].update(sparse={}))
    refuse("without end", lambda s: s["nodes"][0].update(children=[0]))
    refuse(
        "baseColorTexture: found no readable picture",
        lambda s: s["bufferViews"][3].update(byteLength=9),
    )
    refuse(
        "KHR_texture_transform",
        lambda s: s["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"].update(
            extensions={"KHR_texture_transform": {}}
        ),
    )
    refuse("baseColorTexture: found a damaged texture", lambda s: s["textures"].clear())
    material = scene["materials"][0]
    colour = material["pbrMetallicRoughness"]
    for wrong in (
        {"extensionsRequired": 3},
        {"scenes": [[0]], "scene": 0},
        {"materials": [{**material, "pbrMetallicRoughness": [1]}]},
        {"materials": [{**material, "normalTexture": 3}]},
        {"materials": [{"pbrMetallicRoughness": {**colour, "baseColorFactor": ["x", 1, 1]}}]},
    ):
        refuse("damaged", lambda s, wrong=wrong: s.update(wrong))
    scaled = {**material, "normalTexture": {"index": 0, "scale": 0.3}}
    refuse("normalTexture: found a scale of 0.3", lambda s: s.update(materials=[scaled]))
    apart = {**material, "normalTexture": {"index": 0, "texCoord": 1}}
    refuse("texCoord: found UV 0, 1", lambda s: s.update(materials=[apart]))
    (tmp_path / "apart.gltf").write_text(
        json.dumps({**scene, "buffers": [{"uri": "gone.bin", "byteLength": 4}]})
    )
    with pytest.raises(SimError, match=r"gone.bin: found no such file, expected a part of apart"):
        read_scan(tmp_path / "apart.gltf")
    (tmp_path / "out.gltf").write_text(
        json.dumps({**scene, "buffers": [{"uri": "%2e%2e/elsewhere.bin", "byteLength": 4}]})
    )
    with pytest.raises(SimError, match=r"out.gltf, uri: found '../elsewhere.bin', which leaves"):
        read_scan(tmp_path / "out.gltf")


def test_several_colour_textures_are_refused(egg, files, tmp_path):
    scene, data = files["gltf_scene"](egg, files["picture_bytes"]())
    part = copy.deepcopy(scene["meshes"][0]["primitives"][0])
    part["material"] = 1
    scene["meshes"][0]["primitives"].append(part)
    scene["materials"].append({"pbrMetallicRoughness": {}, "name": "eyes"})
    path = tmp_path / "two.glb"
    path.write_bytes(files["glb_bytes"](scene, data))
    with pytest.raises(SimError, match=r"baseColorTexture: found 1 of them on 2 materials.*Bake"):
        read_scan(path)


def test_nan_vertices_are_reported_by_their_number(egg, files, tmp_path):
    places = egg.vertices.copy()
    places[3] = np.nan
    broken = egg.with_vertices(places)
    with pytest.raises(SimError, match=r"vertex \d+: found \d+ NaN or infinite vert"):
        read_scan(files["write_glb"](tmp_path / "nan.glb", broken))
    with pytest.raises(FormatError, match="vertices: found NaN"):
        read_scan(files["write_textured_obj"](tmp_path / "nan.obj", broken))


def test_missing_files_and_materials_are_named(egg, files, tmp_path):
    with pytest.raises(SimError, match=r"absent.glb: found no such file"):
        read_scan(tmp_path / "absent.glb")
    (tmp_path / "scan.fbx").write_bytes(b"fbx")
    with pytest.raises(SimError, match=r"suffix '.fbx', expected .glb, .gltf or .obj"):
        read_scan(tmp_path / "scan.fbx")
    path = files["write_textured_obj"](tmp_path / "egg.obj", egg, files["picture_bytes"]())
    (tmp_path / "skin.png").unlink()
    with pytest.raises(SimError, match=r"skin.png: found no such file, expected a texture"):
        read_scan(path)
    (tmp_path / "skin.mtl").write_text("newmtl other\n")
    with pytest.raises(
        SimError, match="usemtl skin: found no such material, expected one of other"
    ):
        read_scan(path)
    (tmp_path / "skin.mtl").unlink()
    with pytest.raises(SimError, match=r"skin.mtl: found no such file.*--colour"):
        read_scan(path)


def test_texture_names_with_options_and_spaces_are_read(egg, files, tmp_path):
    png = files["picture_bytes"]()
    path = files["write_textured_obj"](tmp_path / "egg.obj", egg, png)
    (tmp_path / "the skin.png").write_bytes(png)
    (tmp_path / "skin.mtl").write_text(
        "newmtl skin\nmap_Kd -s 1 1 1 -clamp on the skin.png\nnorm the skin.png\n"
    )
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.colour.pixels, scan.normals.pixels)


def test_linear_and_encoded_pictures_are_distinguished(tmp_path, files):
    write_exr(tmp_path / "a.exr", np.full((4, 4), 0.25, np.float32))
    picture = read_picture(tmp_path / "a.exr")
    assert picture.linear
    np.testing.assert_array_equal(picture.pixels, np.full((4, 4, 3), 0.25))
    assert not decode_picture(files["picture_bytes"](), "png").linear
    for data in (b"", b"not a picture"):
        with pytest.raises(LightstageError, match="no readable picture"):
            decode_picture(data, "png")


def test_merging_joins_seams_and_leaves_out_vertices_of_no_face():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [1, 0, 1e-3]], float)
    faces = np.array([[0, 1, 2], [3, 4, 2]])
    far = np.concatenate([points, [[1e9, 0, 0]]])
    mesh = merged(far, faces, np.zeros((5, 2)), faces)
    assert len(mesh.vertices) == 4
    np.testing.assert_allclose(mesh.vertices[mesh.faces], points[faces])
    np.testing.assert_array_equal(mesh.face_uvs, faces)
    alone = merged(points * 0, faces, None, None)
    assert len(alone.vertices) == 1
