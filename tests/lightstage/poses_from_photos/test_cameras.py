"""Cameras from photographs alone: where they stood, and every refusal."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lightstage.errors import LightstageError, MotionError
from lightstage.exif import Exif
from lightstage.formats.cameras import approximate_warnings, read_session_cameras
from lightstage.formats.exr import write_exr
from lightstage.formats.landmarks import write_points_px
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path, load_template
from lightstage.poses_from_photos import solving
from lightstage.poses_from_photos.cameras import FoundCameras, find_cameras
from lightstage.poses_from_photos.lengths import Length
from lightstage.poses_from_photos.lenses import shared_lenses
from lightstage.poses_from_photos.pictures import GreyPicture, read_grey
from lightstage.poses_from_photos.points import read_clicks
from lightstage.poses_from_photos.world import turn_between, turned_by_landmarks
from lightstage.rig import default_rig
from tests.lightstage.poses_from_photos import ball
from tests.programs import run_program

LIGHTS = default_rig().lights
BASE_MM = 100.0


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return ball.put(tmp_path_factory.mktemp("ball"), ball.cameras())


@pytest.fixture(scope="module")
def found(shots: dict[str, Path]) -> FoundCameras:
    return find_cameras(shots, LIGHTS, [base()])


def base() -> Length:
    one, two = ball.cameras()[:2]
    return Length("cam0", "cam1", float(np.linalg.norm(one.centre_mm - two.centre_mm)))


def test_cameras_stand_where_they_stood(found: FoundCameras) -> None:
    true = ball.cameras()
    here = np.array([camera.centre_mm for camera in found.rig.cameras])
    there = np.array([camera.centre_mm for camera in true])
    _, misfit = turn_between(here, there)
    assert misfit < 0.01
    spread = [np.linalg.norm(p - p.mean(axis=0)) for p in (here, there)]
    assert abs(spread[0] / spread[1] - 1) < 0.005
    for one, other in zip(found.rig.cameras, true, strict=True):
        off = Rotation.from_matrix(one.cam_from_world[:, :3] @ other.cam_from_world[:, :3].T)
        assert np.degrees(off.magnitude()) < 1.0
        assert abs(one.fx_px / other.fx_px - 1) < 0.03
        assert (one.width_px, one.height_px) == (other.width_px, other.height_px)
        assert np.linalg.norm(one.centre_mm - other.centre_mm) < 40
    assert found.facts["approximate"] is True
    assert found.facts["residual_px"] < 0.4
    assert found.facts["front"] == "camera cam0"
    assert found.facts["scale"]["lengths"] == {str(base()): 0.0}


def test_results_repeat(shots: dict[str, Path], found: FoundCameras) -> None:
    again = find_cameras(shots, LIGHTS, [base()])
    for one, other in zip(found.rig.cameras, again.rig.cameras, strict=True):
        np.testing.assert_allclose(one.cam_from_world, other.cam_from_world, atol=1e-6)


def test_the_command_makes_a_session_that_says_it_is_approximate(tmp_path: Path) -> None:
    cams = ball.cameras()
    ball.put(tmp_path / "in", cams, ("full", "x+"))
    points = {c.id: c.project(np.array([[-40.0, 0, 85], [40.0, 0, 85]]))[0] for c in cams}
    ends = {c: {"left": p[0].tolist(), "right": p[1].tolist()} for c, p in points.items()}
    file = tmp_path / "points.json"
    file.write_text(json.dumps({"schema": "lightstage.points/1", "points_px": ends}))
    marks = {c.id: np.full((68, 2), np.nan) for c in cams}
    write_points_px(marks, tmp_path / "landmarks.json")
    words = ["import", tmp_path / "in", "--json", "--out", tmp_path / "S"]
    words += ["--length", "left:right=80", "--points", file]
    words += ["--length", base(), "--landmarks", tmp_path / "landmarks.json"]
    done = run_program("lightstage", *words)
    assert done.code == 0, done.err
    facts = json.loads(done.out.splitlines()[-1])
    assert facts["frames"] == 10
    assert abs(facts["cameras"]["scale"]["lengths"]["left:right=80"]) < 0.03
    session = load_session(tmp_path / "S")
    assert session.file.calibration.cameras == "calibration/cameras.json"
    assert [c.id for c in session.rig.cameras] == [c.id for c in cams]
    (text,) = approximate_warnings(read_session_cameras(session))
    assert "approximate" in text
    assert "left:right=80" in text
    assert (tmp_path / "S" / "landmarks.json").is_file()


def test_a_face_s_landmarks_turn_the_world(tmp_path: Path) -> None:
    """A face that looks 30 degrees past the frontal camera."""
    template = load_template(default_template_path())
    face = template.mesh.vertices[template.landmarks]
    turn = Rotation.from_euler("y", 30, degrees=True)
    cameras = {camera.id: camera for camera in ball.cameras()}
    clicked = {name: c.project(turn.apply(face * 0.5))[0] for name, c in cameras.items()}
    path = write_points_px(clicked, tmp_path / "landmarks.json")
    found = turned_by_landmarks(read_clicks(path), cameras)
    assert found is not None
    off = Rotation.from_matrix(found @ turn.as_matrix())
    assert np.degrees(off.magnitude()) < 0.1
    few = {name: clicks for name, clicks in read_clicks(path).items() if int(name) < 5}
    assert turned_by_landmarks(few, cameras) is None
    swapped = {camera: points[::-1].copy() for camera, points in clicked.items()}
    path = write_points_px(swapped, tmp_path / "swapped.json")
    with pytest.raises(MotionError, match="off a face's"):
        turned_by_landmarks(read_clicks(path), cameras)


def put_other(path: Path, image: np.ndarray) -> Path:
    write_exr(path, image.astype(np.float32))
    return path


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("two cameras", "found photographs of cam0, cam1, expected 3 cameras at least"),
        ("no length", "--length: found none"),
        ("black", "nothing lit by cam2"),
        ("another ball", "camera cam2: found"),
        ("noise", "camera cam2: found"),
        ("one place", "no depth|no place|matches with"),
        ("unknown camera", "no camera and no point cam9"),
        ("unknown front", "--front: found cam9"),
        ("cut file", "cam2.exr"),
    ],
)
def test_what_cannot_be_solved_is_refused(
    shots: dict[str, Path], tmp_path: Path, fault: str, message: str
) -> None:
    shots, lengths, front = dict(shots), [base()], None
    shape = (*reversed((ball.cameras()[0].width_px, ball.cameras()[0].height_px)), 3)
    if fault == "two cameras":
        shots = {name: shots[name] for name in ("cam0", "cam1")}
    elif fault == "no length":
        lengths = []
    elif fault == "black":
        shots["cam2"] = put_other(tmp_path / "black.exr", np.zeros(shape))
    elif fault == "another ball":
        shots["cam2"] = put_other(tmp_path / "b.exr", ball.photograph(ball.cameras()[2], seed=9))
    elif fault == "noise":
        noise = np.random.default_rng(0).uniform(0.2, 0.8, shape)
        shots["cam2"] = put_other(tmp_path / "noise.exr", noise)
    elif fault == "one place":
        shots = dict.fromkeys(("cam0", "cam1", "cam2"), shots["cam0"])
    elif fault == "unknown camera":
        lengths = [Length("cam0", "cam9", 5.0)]
    elif fault == "unknown front":
        front = "cam9"
    else:
        shots["cam2"] = tmp_path / "cam2.exr"
        shots["cam2"].write_bytes(b"\x76\x2f\x31\x01" + b"\0" * 50)
    with pytest.raises(LightstageError, match=message):
        find_cameras(shots, LIGHTS, lengths, front=front)


def test_photographs_of_a_wall_are_refused(tmp_path: Path) -> None:
    shots = {}
    for camera in ball.cameras((0, 1, 2)):
        shots[camera.id] = put_other(tmp_path / f"{camera.id}.exr", ball.wall(camera))
    with pytest.raises(MotionError, match="photographs of something flat, such as a wall"):
        find_cameras(shots, LIGHTS, [base()])


def test_cameras_that_show_another_person_are_named(tmp_path: Path) -> None:
    shots = {}
    for camera in ball.cameras():
        other = camera.id in ("cam5", "cam6")
        picture = ball.photograph(camera, seed=4 if other else 3)
        shots[camera.id] = put_other(tmp_path / f"{camera.id}.exr", picture)
    with pytest.raises(LightstageError, match="see each other's subject") as caught:
        find_cameras(shots, LIGHTS, [base()])
    assert "camera cam5" in str(caught.value)
    assert "camera cam6" in str(caught.value)
    assert "camera cam1:" not in str(caught.value)


@given(st.floats(-3, 3), st.floats(0.05, 1.0), st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_a_plane_is_flat_and_a_head_is_not(
    tilt: float, depth: float, size: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_euler("xy", [tilt, -tilt]).as_matrix()
    cube = size * rng.uniform(-1, 1, (200, 3))
    solving._refuse_flat(cube * [1, 1, 2 * depth] @ turn.T + size)
    wall = cube * [1, 1, 0.005] @ turn.T + size
    wall[:5] += 3 * size  # false matches
    with pytest.raises(MotionError, match="flat"):
        solving._refuse_flat(wall)


def test_what_ends_colmap_is_reported_in_one_message(
    shots: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = {name: read_grey(path) for name, path in shots.items()}
    exifs = dict.fromkeys(pictures, Exif())

    def without_job(lens: object, picture: object) -> dict[str, object]:
        return {"cameras": [], "focal_px": "wide", "open": True, "centre_px": [None, None]}

    monkeypatch.setattr(solving, "_job", without_job)
    with pytest.raises(MotionError, match="COLMAP ended with 1") as caught:
        solving.solve(pictures, exifs)
    assert "Traceback" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_focal_length_is_begun_with_what_exif_says() -> None:
    picture = GreyPicture(np.zeros((100, 150), np.uint8), np.zeros((100, 150), bool), 4, 600, 400)
    exif = Exif(focal_mm=50.0, focal_plane_px_per_mm=30.0, longer_px=600)
    (lens,) = shared_lenses({"a": picture}, {"a": exif})
    values = {"cameras": ("a",), "focal_px": 375.0, "open": False, "centre_px": [75.0, 50.0]}
    assert solving._job(lens, picture) == values


def test_the_command_refuses_a_rig_together_with_a_length(tmp_path: Path) -> None:
    rig = Path(shutil.copy(Path(default_template_path()).parent / "rig.json", tmp_path / "r.json"))
    words = ["import", tmp_path, "--rig", rig, "--out", tmp_path / "S", "--length", "cam0:cam1=5"]
    done = run_program("lightstage", *words)
    assert done.code == 2
    assert "--length: found together with --rig" in done.err
    assert "Traceback" not in done.err
