"""Whole sessions of a ball: frames, truth, landmarks, and the way through `lightstage capture`."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json

import numpy as np
import pytest
import tifffile

from lightstage.commands import quiet
from lightstage.formats.environment import read_lights
from lightstage.formats.exr import read_exr
from lightstage.formats.landmarks import read_points_mm, read_points_px
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import changed_frames, load_session, missing_frames
from lightstage.patterns import drive_levels, pattern_levels, sequence_patterns
from sim.devices.camera_device import CameraFolders
from sim.devices.capture import capture_session
from sim.devices.photographer import Photographer
from sim.errors import SimError
from sim.light.scene import Scene
from sim.light.world import World
from sim.session import SessionConfig, require_new, truth_path, write_direct, write_landmarks
from sim.truth import relit_sets, vertex_occlusion, write_truth

CONFIG = SessionConfig(click_noise_px=0.0)


@pytest.fixture(scope="module")
def world(ball, tiny_rig):
    return World(ball, tiny_rig)


@pytest.fixture(scope="module")
def direct(world, tmp_path_factory):
    out = tmp_path_factory.mktemp("direct") / "s"
    return write_direct(world, out, CONFIG, 1, quiet)


@pytest.fixture(scope="module")
def truth(world, tmp_path_factory):
    return write_truth(world, tmp_path_factory.mktemp("truth") / "t")


def test_a_direct_session_is_whole_and_well_formed(direct, tiny_rig):
    session = load_session(direct)
    assert session.file.sequence == list(sequence_patterns("binary"))
    assert missing_frames(session) == []
    assert changed_frames(session) == []
    assert {frame.encoding for frame in session.file.frames} == {"linear"}
    np.testing.assert_array_equal(session.levels("x+"), pattern_levels("x+", tiny_rig))


def test_a_session_carries_the_id_of_a_consent_record(direct, world, tmp_path):
    file = write_direct(world, tmp_path / "s", CONFIG, 1, quiet, consent="C-0017")
    assert load_session(file).file.model_extra["consent"] == "C-0017"
    assert "consent" not in load_session(direct).file.model_extra


def test_direct_frames_are_the_worlds_photographs(direct, world, tiny_rig):
    found = read_exr(direct / "frames/y-/cam1.exr")
    known = world.photograph("cam1", pattern_levels("y-", tiny_rig)[None])[0]
    # Half floats keep eleven bits.
    np.testing.assert_allclose(found, known, rtol=6e-4, atol=1e-6)


def test_landmarks_are_projections_where_seen_and_null_where_hidden(direct, world, ball):
    points = read_points_px(direct / "landmarks.json")
    for camera in world.rig.cameras:
        known, _ = camera.project(ball.landmarks_mm)
        toward = camera.centre_mm - ball.landmarks_mm
        cosine = np.sum(toward * ball.landmarks_mm, axis=1) / 80 / np.linalg.norm(toward, axis=1)
        seen = np.isfinite(points[camera.id]).all(axis=1)
        np.testing.assert_allclose(points[camera.id][seen], known[seen], atol=1e-3)
        inside = (known > 0).all(axis=1) & (known < [camera.width_px, camera.height_px]).all(axis=1)
        assert seen[(cosine > 0.2) & inside].all()
        assert not seen[cosine < 0.1].any()


def test_click_noise_has_the_stated_size(world, tmp_path):
    clean = read_points_px(write_landmarks(world, tmp_path / "a.json", 1, 0.0))["cam0"]
    noisy = read_points_px(write_landmarks(world, tmp_path / "b.json", 1, 0.5))["cam0"]
    off = (noisy - clean)[np.isfinite(noisy - clean)]
    assert 0.35 < off.std() < 0.65


def test_truth_maps_of_a_view_state_what_the_camera_sees(truth, world, ball):
    folder = ProcessedFolder(truth)
    surface = world.surfaces["cam1"]
    mask = folder.read_mask("cam1")
    np.testing.assert_array_equal(mask, surface.picture(surface.skin))
    position = folder.read_view("cam1", "position")[mask]
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), 80, atol=0.3)
    normal = folder.read_view("cam1", "specular_normal")[mask]
    assert np.degrees(np.arccos((normal * position / 80).sum(axis=1).clip(-1, 1))).max() < 5
    # A ball hides nothing from itself.
    np.testing.assert_allclose(folder.read_view("cam1", "ambient_occlusion")[mask], 1.0, atol=0.03)
    np.testing.assert_allclose(folder.read_view("cam1", "specular_albedo")[mask], 0.028, rtol=1e-3)
    assert set(np.unique(folder.read_view("cam1", "confidence")[~mask])) == {0.0}


def test_truth_has_the_subjects_own_mesh_landmarks_and_atlas(truth, ball):
    folder = ProcessedFolder(truth)
    mesh = read_mesh(folder.registered_mesh)
    np.testing.assert_allclose(mesh.vertices, ball.mesh.vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, ball.mesh.faces)
    assert len(read_mesh(folder.base_mesh).faces) == len(ball.mesh.triangles())
    np.testing.assert_allclose(
        read_points_mm(truth / "landmarks_mm.json"), ball.landmarks_mm, atol=1e-3
    )
    position = folder.read_atlas("position")
    covered = np.linalg.norm(position, axis=-1) > 0
    np.testing.assert_allclose(np.linalg.norm(position[covered], axis=-1), 80, atol=0.3)
    np.testing.assert_allclose(folder.read_atlas("diffuse_albedo"), ball.diffuse_albedo, rtol=1e-3)
    report = json.loads((truth / "report.json").read_text())
    assert (report["subject"], report["source"]) == ("ball", "analytic")


def test_relit_pictures_are_those_of_their_light_files(truth, world, tiny_rig):
    """The lights read back from JSON, put through the transport, give the picture again."""
    assert {p.stem for p in (truth / "relit").glob("*.exr")} == {"key", "rim", "split"}
    for lights, _ in relit_sets(tiny_rig):
        read = read_lights(truth / "relit" / f"{lights.name}.json")
        weights = np.zeros((len(tiny_rig.lights), 3))
        for place, rgb in zip(read.position_mm, read.rgb, strict=True):
            apart = np.linalg.norm(tiny_rig.positions_mm - place, axis=1)
            assert apart.min() < 1e-6
            weights[int(np.argmin(apart))] = rgb
        found = read_exr(truth / "relit" / f"{lights.name}.exr")
        np.testing.assert_allclose(found, world.relit("cam0", weights), rtol=1e-3, atol=1e-6)
        assert 0.02 < found.max() < 20


def test_no_pattern_shows_a_relit_light_set(tiny_rig):
    lit = [weights.max(axis=1) > 0 for _, weights in relit_sets(tiny_rig)]
    for name in sequence_patterns("binary"):
        shown = pattern_levels(name, tiny_rig) > 0
        assert not any(np.array_equal(shown, mask) for mask in lit)


def test_half_a_sky_is_seen_beside_a_wall(ball):
    """A floor vertex at the foot of an endless wall sees half of the cosine-weighted sky."""
    far = 5000.0
    corners = np.array(
        [[-far, 0, 0], [far, 0, 0], [far, 0, far], [-far, 0, far], [0, 0, 0.3],
         [-far, -1, 0], [far, -1, 0], [far, far, 0], [-far, far, 0]], float
    )  # fmt: skip
    faces = np.array([[0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0], [5, 6, 7], [5, 7, 8]], np.int32)
    wall = Mesh(corners, faces, np.zeros((9, 2)), faces)
    scene = Scene(dataclasses.replace(ball, mesh=wall))
    assert vertex_occlusion(scene, 2000)[4] == pytest.approx(0.5, abs=0.02)


def test_an_old_session_is_not_overwritten(direct):
    with pytest.raises(SimError, match="a session"):
        require_new(direct)
    require_new(truth_path(direct))


def test_the_same_light_gives_the_same_bytes_and_another_seed_others(world, tiny_rig):
    camera = tiny_rig.camera("cam0")
    level = pattern_levels("x+", tiny_rig)
    first, again, other = (Photographer(world, seed) for seed in (1, 1, 2))
    assert first.photograph(camera, level) == again.photograph(camera, level)
    assert first.photograph(camera, level) != other.photograph(camera, level)
    assert first.photograph(camera, level) != first.photograph(camera, 1 - level)


@pytest.mark.usefixtures("forked")
def test_capture_keeps_the_photographs_that_the_lamps_lit(world, tmp_path, tiny_rig):
    """Every count is what the sensor gave under the acknowledged light.

    The levels come back from session.json, so a shot taken a state too early or late would differ.
    What a camera writes beside the picture, such as the moment, is its own.
    """
    pytest.importorskip("gphoto2")
    out = tmp_path / "s"
    capture_session(world, out, 5, "full,x+,x-")
    session = load_session(out)
    assert missing_frames(session) == []
    photographer = Photographer(world, 5)
    for frame in session.file.frames:
        data = session.frame_path(frame).read_bytes()
        levels = session.levels(frame.pattern)
        known = photographer.photograph(tiny_rig.camera(frame.camera), levels)
        found, counts = (tifffile.imread(io.BytesIO(picture)) for picture in (data, known))
        np.testing.assert_array_equal(found, counts)
        assert np.array_equal(levels, drive_levels(frame.pattern, tiny_rig))
        assert hashlib.sha256(data).hexdigest() == frame.sha256
    assert len({frame.sha256 for frame in session.file.frames}) == 3 * len(tiny_rig.cameras)
    assert session.file.calibration.colour == "calibration/colour.json"


@pytest.mark.usefixtures("forked")
def test_a_failed_capture_is_an_error_and_leaves_no_session(world, tmp_path, capfd):
    with pytest.raises(SimError, match="exit code 2"):
        capture_session(world, tmp_path / "s", 5, "full,sideways")
    assert "sideways" in capfd.readouterr().err
    assert not (tmp_path / "s" / "session.json").exists()


@pytest.mark.usefixtures("forked")
def test_lamps_that_fail_end_the_capture_and_give_the_reason(world, tmp_path, monkeypatch):
    def broken(self: Photographer, levels: np.ndarray, folders: CameraFolders) -> None:
        if levels.any():
            raise SimError("lamps", found="no current")
        real(self, levels, folders)

    real = Photographer.photographs
    monkeypatch.setattr(Photographer, "photographs", broken)
    with pytest.raises(SimError, match="no current"):
        capture_session(world, tmp_path / "s", 5, "full")
    assert not (tmp_path / "s" / "session.json").exists()
