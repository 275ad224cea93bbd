"""The scanned head, where its files are at hand, and what is made from its textures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.template import default_template_path, load_template
from sim.errors import SimError
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.scans.lps import head_from_landmarks, load_scan, skin_specular, world_normals

ROWS = 256


@pytest.fixture(scope="module")
def lps(head_data) -> Subject:
    return load_scan(head_data / "lps_head", ROWS)


def test_the_head_has_the_size_and_place_of_a_real_one(lps):
    marks = lps.landmarks_mm
    eyes = marks[36:42].mean(axis=0), marks[42:48].mean(axis=0)
    assert 58 < np.linalg.norm(eyes[0] - eyes[1]) < 70
    crown, chin = lps.mesh.vertices[:, 1].max(), marks[8, 1]
    assert 215 < crown - chin < 240
    # Nose to the front, person's right side at -x, face about the sphere's centre.
    assert marks[30, 2] == marks[:, 2].max()
    assert marks[0, 0] < 0 < marks[16, 0]
    assert np.abs(marks.mean(axis=0)).max() < 60


def test_landmarks_lie_on_the_surface_in_order(lps):
    # Subdivision moves the surface a little under the annotated points.
    tree = cKDTree(lps.mesh.vertices)
    distance, nearest = tree.query(lps.landmarks_mm)
    assert distance.max() < 4.0
    normals = vertex_normals(lps.mesh.vertices, lps.mesh.triangles())[nearest]
    forward = np.r_[17:68]
    assert (normals[forward, 2] > -0.5).all()
    x, y = lps.landmarks_mm[:, 0], lps.landmarks_mm[:, 1]
    assert (np.diff(x[:9]) > 0).all()
    assert (np.diff(x[17:27]) > 0).all()
    assert (np.diff(y[27:31]) < 0).all()
    assert y[37] > y[41]
    assert y[51] > y[62] > y[66] > y[57]
    # Left and right mirror each other to a few mm, as a face does.
    middle = (x[27] + x[30]) / 2
    np.testing.assert_allclose(middle - x[:8], (x[16:8:-1] - middle), atol=6)


def test_the_mesh_is_closed_and_smooth(lps):
    triangles = lps.mesh.triangles()
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, 1)], -1).reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()
    assert len(triangles) == 4 * 17684


def test_fine_normals_follow_the_mesh(lps):
    has = np.linalg.norm(lps.normal, axis=-1)
    assert set(np.unique(np.round(has, 3))) <= {0.0, 1.0}
    smooth = world_normals(lps.mesh, np.full((ROWS, ROWS, 3), [0.5, 0.5, 1.0]))
    off = np.degrees(np.arccos(np.sum(smooth * lps.normal, axis=-1)[lps.skin].clip(-1, 1)))
    assert np.median(off) < 8
    assert np.median(off) > 1


def test_scored_skin_is_the_face(lps):
    assert 0.05 < lps.skin.mean() < 0.3
    assert lps.diffuse_albedo[lps.skin].min() > 0
    assert 0.2 < lps.diffuse_albedo[lps.skin].mean() < 0.6
    assert lps.specular_albedo[lps.skin].mean() == pytest.approx(0.029, abs=0.004)


def test_head_pose_is_rigid_and_near_the_template(lps):
    turn = lps.head_from_world[:, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)
    moved = lps.landmarks_mm @ turn.T + lps.head_from_world[:, 3]
    template = load_template(default_template_path())
    wanted = template.mesh.vertices[template.landmarks]
    assert np.linalg.norm(moved - wanted, axis=1).mean() < 12


def test_head_pose_recovers_a_known_motion():
    template = load_template(default_template_path())
    marks = template.mesh.vertices[template.landmarks]
    angle = 0.3
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    found = head_from_landmarks((marks - [5, 6, 7]) @ turn)
    np.testing.assert_allclose(found[:, :3], turn, atol=1e-9)
    np.testing.assert_allclose(found[:, 3], [5, 6, 7], atol=1e-6)


def test_a_tangent_map_tilts_normals_toward_u_and_v():
    corners = np.array([[0, 0, 0], [0, 0, -1], [0, 1, -1], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2, 3]], np.int32)
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    wall = Mesh(corners, faces, uvs, faces)  # faces +x; u runs along -z, v along +y
    flat = world_normals(wall, np.full((4, 4, 3), [0.5, 0.5, 1.0]))
    np.testing.assert_allclose(flat, np.broadcast_to([1, 0, 0], flat.shape), atol=1e-6)
    red = world_normals(wall, np.full((4, 4, 3), [1.0, 0.5, 0.5]))
    np.testing.assert_allclose(red, np.broadcast_to([0, 0, -1], red.shape), atol=1e-6)
    green = world_normals(wall, np.full((4, 4, 3), [0.5, 1.0, 0.5]))
    np.testing.assert_allclose(green, np.broadcast_to([0, 1, 0], green.shape), atol=1e-6)


def test_specular_values_stay_in_skins_range_even_on_odd_albedo():
    rng = np.random.default_rng(1)
    for albedo in (np.zeros((32, 32, 3)), np.ones((32, 32, 3)), rng.random((32, 32, 3))):
        specular, roughness = skin_specular(albedo.astype(np.float32))
        assert specular.min() >= 0.018 - 1e-6
        assert specular.max() <= 0.040 + 1e-6
        assert roughness.min() >= 0.20 - 1e-6
        assert roughness.max() <= 0.35 + 1e-6


def test_an_absent_or_broken_scan_reports_it(tmp_path, monkeypatch):
    monkeypatch.setenv("LIGHTSTAGE_DATA", str(tmp_path))
    with pytest.raises(SimError, match="--subject parametric"):
        load_subject("lps", 0)
    folder = tmp_path / "lps_head"
    folder.mkdir()
    (folder / "LeePerrySmith.glb").write_bytes(b"no glb")
    with pytest.raises(SimError, match=r"LeePerrySmith.glb.*glTF"):
        load_subject("lps", 0)


def test_the_scan_has_one_expression(head_data, monkeypatch):
    monkeypatch.setenv("LIGHTSTAGE_DATA", str(head_data))
    with pytest.raises(SimError, match="smile, expected neutral"):
        load_subject("lps", 0, "smile")
