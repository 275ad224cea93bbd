"""A scan as a subject: our own head written as one comes back in its place, size and colour."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lightstage.errors import LightstageError
from lightstage.formats.exr import write_exr
from lightstage.formats.mesh import Mesh, vertex_normals
from sim.errors import SimError
from sim.head.mesh import grid_places, landmarks, neutral_mesh, regions
from sim.light.texture import raster_uv
from sim.scans.checks import CheckConfig
from sim.scans.lps import load_scan
from sim.scans.match import carried, own_grid_uv
from sim.scans.reading import read_scan
from sim.scans.scan import WORLD_SHIFT_MM, ScanConfig, import_scan

ROWS = 96
ANNOTATED = Path(__file__).parents[3] / "sim" / "data" / "lps_landmarks.json"
OPEN = CheckConfig(largest_hole_mm=1e3)
COARSE = ScanConfig(checks=OPEN, facet_mm=1e3)


def place_of(mesh: Mesh) -> np.ndarray:
    return np.sort(mesh.vertices, axis=0)


@pytest.fixture(scope="module")
def scan(head, files, tmp_path_factory):
    """Our head as a .glb in metres, turned and shifted, and its landmarks in the same axes."""
    tmp_path = tmp_path_factory.mktemp("scan")
    mesh, marks = head
    turn = Rotation.from_euler("xyz", [20, -35, 10], degrees=True).as_matrix()
    moved = mesh.with_vertices(mesh.vertices @ turn.T + [100, 200, 300])
    path = files["write_glb"](tmp_path / "head.glb", moved, files["picture_bytes"](ROWS, 64))
    return path, files["landmarks_file"](tmp_path / "marks.json", marks @ turn.T + [100, 200, 300])


@pytest.fixture(scope="module")
def read(scan):
    """The subject and the report of that scan."""
    return import_scan(scan[0], "head", scan[1], config=COARSE)


def test_landmarks_turn_a_scan_upright_into_the_stage(read, head):
    mesh, marks = head
    subject, report = read
    assert report.mm_per_unit == 1000.0
    assert report.landmarks == 68
    assert report.made_up == ("specular albedo", "translucency", "roughness", "relief")
    np.testing.assert_allclose(subject.landmarks_mm, marks + WORLD_SHIFT_MM, atol=1.5)
    used = np.unique(mesh.faces)
    there = mesh.with_vertices(mesh.vertices[used] + WORLD_SHIFT_MM)
    if len(subject.mesh.vertices) == len(used):
        np.testing.assert_allclose(place_of(subject.mesh), place_of(there), atol=1.5)
    turn, shift = subject.head_from_world[:, :3], subject.head_from_world[:, 3]
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(subject.landmarks_mm @ turn.T + shift, marks, atol=1.5)


def test_colour_is_decoded_to_linear_light_and_its_rows_are_kept(scan, read):
    subject, _ = read
    assert subject.diffuse_albedo.shape == (ROWS, 64, 3)
    encoded = np.array([200, 120, 60]) / 255
    wanted = ((encoded + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(subject.diffuse_albedo[ROWS // 2, 60], wanted, atol=2e-3)
    half, _ = import_scan(
        scan[0], "head", scan[1], config=ScanConfig(checks=OPEN, facet_mm=1e3, rows=48)
    )
    assert half.roughness.shape == (48, 32)


def test_scored_skin_is_our_heads_skin_carried_over(read, head):
    subject, _ = read
    mesh, marks = head
    face, _ = raster_uv(dataclasses.replace(mesh), ROWS, 64)
    inside = np.zeros(len(mesh.vertices), bool)
    inside[np.concatenate([regions()["skin"], regions()["lips"]])] = True
    wanted = inside[mesh.faces].all(axis=1)[face] & (face >= 0)
    low = mesh.vertices[mesh.faces][..., 1].max(axis=1)[face] < marks[:, 1].min() - 31
    wanted &= ~low
    assert (subject.skin & wanted).sum() > 0.9 * wanted.sum()
    assert 0.5 < subject.skin.sum() / wanted.sum() < 1.3
    eyes = np.isin(mesh.faces, regions()["eyes"]).all(axis=1)[face] & (face >= 0)
    assert not (subject.skin & eyes).any()


def test_normals_are_the_surfaces_with_a_small_relief(scan, read):
    subject, _ = read
    flat, _ = import_scan(
        scan[0], "head", scan[1], config=ScanConfig(checks=OPEN, facet_mm=1e3, relief_mm=0.0)
    )
    length = np.linalg.norm(flat.normal, axis=-1)
    covered = length > 0
    np.testing.assert_allclose(length[covered], 1, atol=1e-3)
    mesh = flat.mesh
    face, weights = raster_uv(mesh, ROWS, 64)
    corners = vertex_normals(mesh.vertices, mesh.triangles())[mesh.triangles()[face[covered]]]
    smooth = np.einsum("nck,nc->nk", corners, weights[covered])
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    np.testing.assert_allclose(flat.normal[covered], smooth, atol=1e-3)
    tilt = np.arccos(np.clip((flat.normal * subject.normal).sum(axis=-1)[covered], -1, 1))
    assert np.degrees(np.percentile(tilt, 99)) < 20


def test_a_normal_map_and_a_roughness_map_are_used(head, files, tmp_path):
    mesh, _ = head
    scene, data = files["gltf_scene"](
        mesh.with_vertices(mesh.vertices / 1000), files["picture_bytes"](ROWS, 64)
    )
    tilted = np.full((48, 32, 3), [255, 128, 128], np.uint8)[:, :, ::-1]
    gloss = np.full((48, 32, 3), [0, 128, 0], np.uint8)
    material = scene["materials"][0]
    for name, image in (("n", tilted), ("r", gloss)):
        (tmp_path / f"{name}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
        scene["images"].append({"uri": f"{name}.png"})
        scene["textures"].append({"source": len(scene["images"]) - 1})
    material["normalTexture"] = {"index": 1}
    material["pbrMetallicRoughness"]["metallicRoughnessTexture"] = {"index": 2}
    path = tmp_path / "maps.glb"
    path.write_bytes(files["glb_bytes"](scene, data))
    subject, report = import_scan(path, "head", config=COARSE)
    assert report.made_up == ("specular albedo", "translucency")
    np.testing.assert_allclose(subject.roughness, (128 / 255) ** 2, atol=1e-3)
    material["pbrMetallicRoughness"]["roughnessFactor"] = 0.9
    path.write_bytes(files["glb_bytes"](scene, data))
    np.testing.assert_allclose(read_scan(path).roughness_factor, 0.9)
    glossier, _ = import_scan(path, "head", config=COARSE)
    np.testing.assert_allclose(glossier.roughness, (0.9 * 128 / 255) ** 2, atol=1e-3)
    # Tilted all the way along u, normals lie in the surface.
    face, weights = raster_uv(subject.mesh, ROWS, 64)
    normals = vertex_normals(subject.mesh.vertices, subject.mesh.triangles())
    corners = normals[subject.mesh.triangles()[face]]
    smooth = np.einsum("rckx,rck->rcx", corners, weights)
    cosine = np.abs((smooth * subject.normal).sum(axis=-1))[face >= 0]
    assert np.median(cosine) < 0.02
    material["normalTexture"] = {"index": 0}
    scene["images"][0] = {"uri": "wide.png"}
    (tmp_path / "wide.png").write_bytes(files["picture_bytes"](32, 64))
    material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 1}
    path.write_bytes(files["glb_bytes"](scene, data))
    with pytest.raises(SimError, match=r"normals: found 32 rows x 64 columns, expected the colour"):
        import_scan(path, "head", config=COARSE)


def test_without_landmarks_crown_and_nose_lie_where_our_heads_do(head, files, tmp_path):
    mesh, _ = head
    shifted = mesh.with_vertices(mesh.vertices + np.array([30, -500, 70]))
    path = files["write_textured_obj"](
        tmp_path / "h.obj", shifted, files["picture_bytes"](ROWS, 64)
    )
    subject, report = import_scan(path, "head", config=COARSE)
    assert report.landmarks == 0
    assert np.isnan(subject.landmarks_mm).all()
    used = np.unique(mesh.faces)
    want = mesh.vertices[used] + WORLD_SHIFT_MM
    np.testing.assert_allclose(subject.mesh.vertices.max(axis=0), want.max(axis=0), atol=2.0)
    face, _ = raster_uv(subject.mesh, ROWS, 64)
    np.testing.assert_array_equal(subject.skin, face >= 0)


def test_landmarks_that_are_wrong_are_refused(scan, read, files, tmp_path):
    path, marks_path = scan
    points = np.array(json.loads(marks_path.read_text())["points_mm"], float)
    config = COARSE

    def refuse(said, points, field="points_mm"):
        file = files["landmarks_file"](tmp_path / "wrong.json", points, field)
        with pytest.raises(LightstageError, match=said):
            import_scan(path, "head", file, config=config)

    refuse("found 67 entries, expected 68", points[:67])
    few = points.copy()
    few[5:] = np.nan
    refuse("found 5 known, expected at least 8", few)
    refuse(r"size: found 0\.\d+ mm \(eyes", points / 1000)
    refuse(r"size: found 9\S+ mm \(eyes", points, "points")
    refuse("off the surface, by up to", points + 60)
    refuse("mm rms from a head's.*iBUG's", np.concatenate([points[16::-1], points[17:]]))
    (tmp_path / "wrong.json").write_text('{"scheme": "w300", "points_mm": []}')
    with pytest.raises(SimError, match="scheme"):
        import_scan(path, "head", tmp_path / "wrong.json", config=config)
    in_metres = files["landmarks_file"](tmp_path / "m.json", points / 1000, "points")
    subject, _ = import_scan(path, "head", in_metres, config=config)
    np.testing.assert_allclose(subject.landmarks_mm, read[0].landmarks_mm, atol=1e-6)


def test_some_unknown_landmarks_are_enough(scan, files, tmp_path):
    points = np.array(json.loads(scan[1].read_text())["points_mm"], float)
    points[::3] = np.nan
    file = files["landmarks_file"](tmp_path / "some.json", points)
    subject, report = import_scan(scan[0], "head", file, config=COARSE)
    assert report.landmarks == 45
    np.testing.assert_array_equal(np.isnan(subject.landmarks_mm[:, 0]), np.isnan(points[:, 0]))
    assert subject.skin.any()


def test_a_scan_in_centimetres_is_reported_and_taken_with_its_unit(egg, files, tmp_path):
    small = egg.with_vertices(egg.vertices / 10)
    path = files["write_textured_obj"](tmp_path / "c.obj", small, files["picture_bytes"](ROWS, 64))
    with pytest.raises(SimError, match=r"c.obj, size: found \d+\.?\d* mm .*--units cm"):
        import_scan(path, "head", config=COARSE)
    for unit in ("cm", "10", "10.0"):
        subject, report = import_scan(
            path, "head", config=ScanConfig(units=unit, checks=OPEN, facet_mm=1e3)
        )
        assert report.mm_per_unit == 10.0
        assert np.ptp(subject.mesh.vertices, axis=0).max() == pytest.approx(189, abs=1)
    for unit in ("inch", "0", "-1", "nan", ""):
        with pytest.raises(SimError, match="--units: found"):
            import_scan(path, "head", config=ScanConfig(units=unit))


def test_albedo_out_of_range_and_absent_colour_are_refused(egg, files, tmp_path):
    path = files["write_textured_obj"](tmp_path / "h.obj", egg)
    config = COARSE
    with pytest.raises(SimError, match=r"colour: found no colour texture.*--colour"):
        import_scan(path, "head", config=config)
    colour = tmp_path / "c.exr"
    image = np.full((ROWS, 64, 3), 0.5, np.float32)
    image[2, 3] = -0.1
    write_exr(colour, image, half=False)
    with pytest.raises(SimError, match=r"c.exr, texel \(2, 3\): found albedo of -0.1"):
        import_scan(path, "head", colour=colour, config=config)
    write_exr(colour, np.full((ROWS, 64, 3), 1.5, np.float32))
    with pytest.raises(SimError, match=r"albedo up to 1.5, expected 0 to 1.*white diffuser"):
        import_scan(path, "head", colour=colour, config=config)
    write_exr(colour, np.full((ROWS, 64, 3), 0.25, np.float32))
    subject, _ = import_scan(path, "head", colour=colour, config=config)
    np.testing.assert_allclose(subject.diffuse_albedo, 0.25, atol=1e-3)


def test_our_own_head_corresponds_to_itself():
    mesh = neutral_mesh()
    marks = mesh.vertices[landmarks()]
    chosen = np.random.default_rng(0).choice(np.unique(mesh.faces[mesh.faces >= 0]), 2000)
    there = carried(mesh.vertices[chosen], marks)
    np.testing.assert_allclose(there, mesh.vertices[chosen], atol=0.05)
    uv, off = own_grid_uv(mesh.vertices[chosen])
    assert off.max() < 1e-3
    corners, uvs = mesh.triangles(), mesh.triangle_uvs()
    own = np.full((len(mesh.vertices), 2), np.nan)
    own[corners.ravel()] = grid_places()[uvs.ravel()]
    # At the seam behind the head a vertex has two places.
    apart = np.linalg.norm(uv - own[chosen], axis=1)
    assert np.mean(apart < 0.01) > 0.97
    kept, _ = own_grid_uv(mesh.vertices[regions()["eyes"]], with_eyes=False)
    with_eyes, _ = own_grid_uv(mesh.vertices[regions()["eyes"]])
    assert np.abs(kept - with_eyes).max() > 1e-3


def test_the_lee_perry_smith_scan_imports_as_its_own_loader_reads_it(head_data):
    folder = head_data / "lps_head"
    known = load_scan(folder, 256)
    subject, report = import_scan(
        folder / "LeePerrySmith.glb",
        "LPS2",
        ANNOTATED,
        folder / "Map-COL.jpg",
        folder / "Infinite-Level_02_Tangent_SmoothUV.jpg",
        config=ScanConfig(units="52", flip_v=True, rows=256),
    )
    assert report.mesh.holes_mm == ()
    np.testing.assert_array_equal(subject.mesh.faces, known.mesh.faces)
    head = [
        s.mesh.vertices @ s.head_from_world[:, :3].T + s.head_from_world[:, 3]
        for s in (subject, known)
    ]
    np.testing.assert_allclose(*head, atol=1e-4)
    np.testing.assert_allclose(
        subject.landmarks_mm,
        subject.mesh.vertices[0]
        + (known.landmarks_mm - known.mesh.vertices[0])
        @ (subject.head_from_world[:, :3].T @ known.head_from_world[:, :3]).T,
        atol=1e-4,
    )
    both = np.linalg.norm(known.normal, axis=-1) > 0
    turned = known.normal @ known.head_from_world[:, :3].T.astype(np.float32)
    np.testing.assert_allclose(subject.normal[both], turned[both], atol=1e-3)
    # One shrinks the texture in linear light, the other as it is encoded.
    gap = np.abs(subject.diffuse_albedo - known.diffuse_albedo)[both]
    assert np.percentile(gap, 99) < 0.01
    # The annotated outline and the carried skin agree about the face.
    assert (subject.skin & known.skin).sum() > 0.85 * known.skin.sum()
