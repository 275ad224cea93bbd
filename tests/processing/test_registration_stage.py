import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lightstage.errors import FormatError
from lightstage.formats.landmarks import write_points_px
from lightstage.formats.mesh import Mesh, read_obj, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, SessionFile
from lightstage.formats.template import (
    Template,
    default_template_path,
    load_template,
)
from lightstage.rig import Light, Rig
from processing.errors import RegistrationError
from processing.registration.config import RegisterConfig
from processing.registration.rigid import Similarity
from processing.registration.stage import head_pose, open_to_sky, register, register_mesh
from processing.registration.target import Target
from tests.processing.shapes import camera, ellipsoid_template, refined, warp

POSE = Similarity(Rotation.from_rotvec([0.1, 0.3, -0.05]).as_matrix(), np.array([8.0, -20, 15]))


def warped_person():
    """An ellipsoid template, its person in the world, and the front of that person as a scan."""
    template = ellipsoid_template()
    truth = POSE.apply(warp(template.mesh.vertices, 4.0))
    whole = refined(template.mesh.with_vertices(truth))
    front = (whole.vertices[whole.faces][:, :, 2] > -10).all(axis=1)
    return template, truth, Mesh(whole.vertices, whole.faces[front])


def test_a_posed_and_warped_person_is_registered():
    template, truth, scan = warped_person()
    vertices, facts = register_mesh(scan, truth[template.landmarks], template, RegisterConfig())
    seen = truth[:, 2] > 15
    assert np.median(Target(scan).closest(vertices[seen]).distance_mm) < 0.05
    assert np.linalg.norm(vertices - truth, axis=1)[seen].mean() < 0.8
    assert facts["landmarks_mean_mm"] < 0.3
    assert facts["triangles_flipped"] == 0
    assert facts["landmarks_left_out"] == []
    json.dumps(facts)


def test_a_wrong_landmark_is_named_and_does_not_bend_the_face():
    template, truth, scan = warped_person()
    marks = truth[template.landmarks].copy()
    marks[40] += [0, 35, 0]
    vertices, facts = register_mesh(scan, marks, template, RegisterConfig())
    assert len(facts["landmarks_left_out"]) == 1
    assert "landmark 40" in facts["landmarks_left_out"][0]
    assert np.linalg.norm(vertices - truth, axis=1)[template.landmarks[40]] < 3


def test_four_landmarks_are_enough():
    template, truth, scan = warped_person()
    marks = np.full((68, 3), np.nan)
    few = [0, 15, 40, 67]
    marks[few] = truth[template.landmarks[few]]
    vertices, facts = register_mesh(scan, marks, template, RegisterConfig())
    assert facts["landmarks_used"] == 4
    seen = truth[:, 2] > 15
    assert np.median(Target(scan).closest(vertices[seen]).distance_mm) < 0.1


def refusal(change, template_scale=1.0):
    template, truth, scan = warped_person()
    marks = truth[template.landmarks]
    scan, marks = change(scan, marks.copy())
    mesh = template.mesh.with_vertices(template.mesh.vertices * np.asarray(template_scale))
    scaled = dataclasses.replace(template, mesh=mesh)
    with pytest.raises(RegistrationError) as caught:
        register_mesh(scan, marks, scaled, RegisterConfig())
    return str(caught.value)


def only(indices, marks):
    out = np.full_like(marks, np.nan)
    out[indices] = marks[indices]
    return out


def test_three_landmarks_are_refused():
    message = refusal(lambda scan, marks: (scan, only([0, 20, 50], marks)))
    assert "3 of 68" in message
    assert "at least 4" in message


def test_landmarks_in_one_plane_are_refused():
    def flatten(scan, marks):
        marks[:, 2] = 40
        return scan, marks

    assert "one plane" in refusal(flatten)


def test_a_scan_in_metres_is_refused():
    message = refusal(lambda scan, marks: (scan.with_vertices(scan.vertices / 1000), marks / 1000))
    assert "found a scan 0.00101 times as large as the template, expected both in mm" in message
    assert "Scale the scan and its landmarks (metres x 1000, centimetres x 10)" in message


@pytest.mark.parametrize(("scale", "message"), [(0.1, "a scan 10"), (1e-3, "e+03 times")])
def test_a_template_in_centimetres_or_metres_is_refused(scale, message):
    assert message in refusal(lambda scan, marks: (scan, marks), template_scale=scale)


def test_a_mirrored_template_is_refused():
    message = refusal(lambda scan, marks: (scan, marks), template_scale=[-1, 1, 1])
    assert "mirror" in message


def test_a_mirrored_scan_is_refused():
    def mirror(scan, marks):
        # A face is nearly its own mirror image, but its landmarks' order is not.
        return scan.with_vertices(scan.vertices * [-1, 1, 1]), marks * [-1, 1, 1]

    assert "mirror" in refusal(mirror)


def test_landmarks_in_another_order_are_refused():
    shuffled = np.random.default_rng(0).permutation(68)
    assert "order" in refusal(lambda scan, marks: (scan, marks[shuffled]))


def test_landmarks_of_another_place_are_refused():
    assert "coordinates" in refusal(lambda scan, marks: (scan, marks + np.array([0, 0, 150.0])))


def test_head_pose_ignores_a_moved_jaw():
    template = ellipsoid_template()
    head = template.mesh.vertices
    moved = head - np.outer(head[:, 1] < -50, [0, 15, 5])
    found = head_pose(POSE.apply(moved), template)
    assert found.scale == 1.0
    assert np.abs(found.apply(POSE.apply(head)) - head).max() < 0.5


def test_the_inside_of_a_cavity_sees_no_sky():
    template = ellipsoid_template()
    outside = template.mesh
    inner = outside.vertices * 0.3
    vertices = np.concatenate([outside.vertices, inner])
    triangles = np.concatenate([outside.triangles(), outside.triangles() + len(inner)])
    is_open = open_to_sky(vertices, triangles, 0.08)
    assert is_open[: len(inner)].all()
    assert not is_open[len(inner) :].any()


def make_session(root, cameras):
    light = Light(0, "one", (0.0, 0.0, 1250.0), "horizontal")
    file = SessionFile(
        id="a", created_utc="", subject="s", expression="neutral", sequence=[], frames=[]
    )
    return Session(root, file, Rig((light,), tuple(cameras)))


def test_the_stage_reads_clicks_and_writes_mesh_and_pose(tmp_path):
    template, truth, scan = warped_person()
    cameras = [camera(f"cam{i}", a) for i, a in enumerate((0, -30, 30))]
    session = make_session(tmp_path / "session", cameras)
    out = ProcessedFolder(tmp_path / "out")
    write_ply(scan, out.base_mesh)
    clicks = {c.id: c.project(truth[template.landmarks])[0] for c in cameras}
    clicks["cam1"][12] += [30, 0]
    clicks["cam2"][20] = np.nan
    write_points_px(clicks, session.root / "landmarks.json")
    facts = register(session, out.root, template, RegisterConfig())
    assert facts["landmarks_triangulated"] == 68
    assert len(facts["clicks_left_out"]) == 1
    assert "cam1 landmark 12" in facts["clicks_left_out"][0]
    mesh = read_obj(out.registered_mesh)
    assert np.array_equal(mesh.faces, template.mesh.faces)
    assert np.array_equal(mesh.face_uvs, template.mesh.face_uvs)
    seen = truth[:, 2] > 15
    assert np.linalg.norm(mesh.vertices - truth, axis=1)[seen].mean() < 0.8
    pose = np.array(json.loads(out.head_pose.read_text())["head_from_world"])
    assert np.allclose(pose[:, :3] @ pose[:, :3].T, np.eye(3), atol=1e-9)
    assert 0 < facts["residual_median_mm"] < 0.1
    assert facts["residual_angle_median_deg"] < 5
    with np.load(out.root / "work" / "registration" / "residual.npz") as left:
        assert left["distance_mm"].shape == (len(truth),)
        assert np.nanmax(np.abs(left["distance_mm"][seen])) < 1
    back = truth @ pose[:, :3].T + pose[:, 3]
    assert np.linalg.norm(back - template.mesh.vertices, axis=1).mean() < 6


def test_the_stage_asks_for_landmarks(tmp_path):
    template, _, scan = warped_person()
    write_ply(scan, tmp_path / "out" / "base_mesh.ply")
    session = make_session(tmp_path / "session", [camera("cam0", 0)])
    with pytest.raises(RegistrationError, match=r"landmarks\.json"):
        register(session, tmp_path / "out", template, RegisterConfig())
    assert not (tmp_path / "out" / "registered_mesh.obj").exists()


def test_the_stage_refuses_clicks_of_unknown_cameras(tmp_path):
    template, _, scan = warped_person()
    write_ply(scan, tmp_path / "out" / "base_mesh.ply")
    session = make_session(tmp_path / "session", [camera("cam0", 0)])
    write_points_px({"left": np.zeros((68, 2))}, session.root / "landmarks.json")
    with pytest.raises(FormatError, match="left"):
        register(session, tmp_path / "out", template, RegisterConfig())


def test_our_own_template_finds_a_person_made_of_its_modes():
    template = load_template(default_template_path())
    assert template.modes is not None
    rng = np.random.default_rng(3)
    coefficients = rng.normal(size=len(template.modes.identity))
    head = template.mesh.vertices + np.tensordot(coefficients, template.modes.identity, axes=1)
    truth = POSE.apply(warp(head, 2.0))
    scan = refined(template.mesh.with_vertices(truth))
    front = (scan.vertices[scan.faces] @ POSE.rotation[:, 2] > 20).all(axis=1)
    marks = truth[template.landmarks]
    vertices, facts = register_mesh(
        Mesh(scan.vertices, scan.faces[front]), marks, template, RegisterConfig()
    )
    seen = np.zeros(len(truth), bool)
    seen[template.regions["skin"]] = True
    seen &= truth @ POSE.rotation[:, 2] > 40
    error = np.linalg.norm(vertices - truth, axis=1)[seen]
    assert error.mean() < 1.0
    assert facts["template_to_scan_median_mm"] < 0.1
    assert facts["landmarks_mean_mm"] < 0.5
    assert facts["triangles_flipped"] == 0


def test_another_face_model_registers_to_a_known_person(head_data):
    folder = head_data / "ict_facekit"
    with np.load(folder / "ict_facekit_modes.npz", allow_pickle=False) as file:
        neutral = file["neutral_vertices_cm"].astype(float)
        faces = file["faces"]
        identity = file["identity_modes_cm"].astype(float) * 10
    count = 11248  # face, head and neck; behind them come eyes and teeth
    indices = json.loads((folder / "FaceXModel" / "vertex_indices.json").read_text())
    mesh = Mesh(neutral[:count] * 10, faces[faces.max(axis=1) < count].astype(np.int32))
    template = Template(
        "ict", mesh, np.array(indices["idx_to_landmark_verts"]), {}, "", "", modes=None
    )
    weights = np.random.default_rng(5).normal(size=len(identity))
    truth = POSE.apply(mesh.vertices + np.tensordot(weights, identity[:, :count], axes=1))
    scan = mesh.with_vertices(truth)
    face = np.arange(count) < 9409
    vertices, facts = register_mesh(scan, truth[template.landmarks], template, RegisterConfig())
    error = np.linalg.norm(vertices - truth, axis=1)[face]
    # The shape moved by more than 3 mm; this is correspondence, not surface.
    assert error.mean() < 1.5
    assert facts["template_to_scan_median_mm"] < 0.1
