"""Targets in the stage: found where their truth says, and lit as formulas say."""

from __future__ import annotations

import dataclasses
import json

import cv2
import numpy as np
import pytest
import rawpy
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from lightstage.commands import quiet
from lightstage.formats.mesh import Mesh
from lightstage.formats.session import changed_frames, load_session, missing_frames
from lightstage.rig import default_rig, save_rig
from sim.__main__ import app
from sim.camera.chart import chart_reflectance
from sim.camera.flaws import PRESETS, CaptureFlaws, LensConfig
from sim.camera.optics import make_lens
from sim.errors import SimError
from sim.light.lamps import lamps_of
from sim.light.world import World
from sim.people.subject import Subject
from sim.targets.ball import Ball, photograph_grey, photograph_mirror
from sim.targets.boards import BoardConfig, board_poses, chart_plane, facing
from sim.targets.light import white_reading
from sim.targets.plane import Plane, photograph_plane
from sim.targets.target_session import TargetsConfig, make_targets, write_targets

SCALE = 0.1795
NO_ROOM = np.zeros(3)
CONFIG = TargetsConfig(board_poses=2, mirror_places_mm=((0, 0, 0),), flats=2, darks=1)
# A lens as in `lab`, straight; what it blurs is what a detector of corners is used to.
FLAWS = dataclasses.replace(
    PRESETS["lab"], lens=dataclasses.replace(PRESETS["lab"].lens, distortion_k1=0.0, blur_um=20.0)
)


@pytest.fixture(scope="module")
def rig():
    whole = default_rig().scaled(SCALE)
    bent = dataclasses.replace(whole.cameras[0], dist=(-0.2, 0.1, 0.002, -0.001, 0.0))
    return dataclasses.replace(whole, cameras=(bent, whole.cameras[1]))


@pytest.fixture(scope="module")
def full(rig):
    return np.ones(len(rig.lights))


@pytest.fixture(scope="module")
def written(rig, tmp_path_factory):
    out = tmp_path_factory.mktemp("targets") / "cal"
    return write_targets(rig, out, CONFIG, FLAWS, 3, quiet)


@pytest.fixture(scope="module")
def truth(written):
    return json.loads((written.parent / "cal.truth" / "targets.json").read_text())


def counts_of(session, pattern: str, camera: str) -> np.ndarray:
    with rawpy.imread(str(session / "frames" / pattern / f"{camera}.dng")) as raw:
        return raw.raw_image_visible.copy()


def developed(session, pattern: str, camera: str) -> np.ndarray:
    """(h, w, 3) camera colours, 0..1 of white."""
    share = (counts_of(session, pattern, camera) - 600.0) / (16383 - 600)
    counts = np.rint(np.clip(share, 0, 1) * 65535).astype(np.uint16)
    return cv2.cvtColor(counts, cv2.COLOR_BAYER_RGGB2RGB) / 65535


def places(entry: dict, camera: str) -> np.ndarray:
    found = entry["cameras"][camera]["places_px"]
    return np.array([[np.nan, np.nan] if p is None else p for p in found])


def test_the_targets_are_a_session_whose_every_photograph_reads(written, rig):
    session = load_session(written)
    assert missing_frames(session) == []
    assert changed_frames(session) == []
    kinds = {name.split("-")[0] for name in session.file.sequence}
    assert kinds == {"charuco", "chart", "mirror", "grey", "flat", "dark"}
    assert session.levels("charuco-00").min() == 1.0
    assert session.levels("flat-00").max() == 0.0


def test_opencv_finds_the_boards_corners_within_a_tenth_of_a_pixel(written, truth):
    detector = cv2.aruco.CharucoDetector(CONFIG.board.board())
    for index in range(CONFIG.board_poses):
        name = f"charuco-{index:02d}"
        for camera in ("cam0", "cam1"):
            grey = developed(written, name, camera)[..., 1]
            picture = np.rint(255 * grey / grey.max()).astype(np.uint8)
            corners, ids, *_ = detector.detectBoard(picture)
            known = places(truth["targets"][name], camera)
            assert len(ids) > 0.8 * np.isfinite(known).all(axis=1).sum() > 30
            # OpenCV's first pixel is centred on (0, 0).
            off = np.asarray(corners).reshape(-1, 2) + 0.5 - known[np.ravel(ids)]
            off = off[np.isfinite(off).all(axis=1)]
            assert np.sqrt((off**2).sum(axis=1).mean()) < 0.06
            assert np.abs(off).max() < 0.12
            assert np.abs(off.mean(axis=0)).max() < 0.03


def test_opencv_finds_the_chart_where_it_is(written, truth):
    picture = developed(written, "chart-01", "cam1")
    encoded = np.clip(picture / picture.max(), 0, 1) ** (1 / 2.2)
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    image = np.ascontiguousarray((encoded * 255).astype(np.uint8)[..., ::-1])
    assert detector.process(image, 1)
    corners = np.asarray(detector.getBestColorChecker().getColorCharts()).reshape(24, 4, 2)
    known = places(truth["targets"]["chart-01"], "cam1")
    np.testing.assert_allclose(corners.mean(axis=1) + 0.5, known, atol=10.0)  # of 70 pixels a patch


def test_the_charts_patches_give_the_published_reflectances_back(written, truth):
    """Through the sensor's own matrix, exposure, shading and the light on each patch."""
    entry = truth["targets"]["chart-01"]
    picture = developed(written, "chart-01", "cam1") / entry["exposure_factor"]
    matrix = np.array(truth["sensors"]["cam1"]["raw_from_linear"])
    linear = picture @ np.linalg.inv(matrix).T
    pose = np.array(entry["world_from_target"])
    spots = np.array(entry["places_mm"])
    world = spots @ pose[:, :2].T + pose[:, 3]
    session = load_session(written)
    lamps = lamps_of(session.rig, FLAWS.lamps, 3)
    normals = np.broadcast_to(-pose[:, 2], world.shape)
    white = white_reading(world, normals, lamps, np.ones(len(lamps.weights)))
    white = white + FLAWS.room.ambient * np.array(FLAWS.room.ambient_rgb)
    lens = make_lens(session.rig.camera("cam1"), FLAWS.lens, 3)
    for index, (x, y) in enumerate(places(entry, "cam1")):
        part = slice(int(y) - 12, int(y) + 12), slice(int(x) - 12, int(x) + 12)
        found = linear[part].mean(axis=(0, 1)) / white[index] / lens.shading[part].mean()
        np.testing.assert_allclose(found, chart_reflectance()[index], atol=0.006)


def test_darks_are_noise_around_black_and_flats_show_the_vignetting(written, rig, truth):
    dark = counts_of(written, "dark-00", "cam1").astype(float)
    sensor = truth["sensors"]["cam1"]
    assert dark.mean() == pytest.approx(600, abs=0.1)
    known = np.hypot(sensor["read_noise_e"] / sensor["electrons_per_dn"], 12**-0.5)
    assert dark.std() == pytest.approx(known, rel=0.01)
    flats = [counts_of(written, f"flat-{k:02d}", "cam1").astype(float) - 600 for k in (0, 1)]
    shading = make_lens(rig.cameras[1], FLAWS.lens, 3).shading
    green = flats[0][::2, 1::2]
    span = (16383 - 600) * 0.5 * np.array(sensor["raw_from_linear"])[1].sum()
    np.testing.assert_allclose(
        cv2.blur(green, (41, 41)), cv2.blur(span * shading[::2, 1::2], (41, 41)), rtol=0.01
    )
    # Two flats differ by noise alone: twice photons and reading.
    part = slice(300, 700), slice(200, 500)
    apart = (flats[0] - flats[1])[part][::2, 1::2]
    mean_e = flats[0][part][::2, 1::2].mean() * sensor["electrons_per_dn"]
    noise = np.sqrt(2 * (mean_e + sensor["read_noise_e"] ** 2)) / sensor["electrons_per_dn"]
    assert apart.std() == pytest.approx(noise, rel=0.02)


def plane_subject(plane: Plane, ball: Subject) -> Subject:
    """The plane as a mesh with texture, for the simulator's other hand."""
    (x, y), (w, h) = plane.corner_mm, plane.size_mm
    square = np.array([[x, y + h], [x + w, y + h], [x + w, y], [x, y]])
    faces = np.array([[0, 1, 2, 3]], np.int32)
    uvs = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    shape = plane.reflectance.shape[:2]
    normal = np.broadcast_to(plane.normal.astype(np.float32), (*shape, 3))
    return dataclasses.replace(
        ball,
        mesh=Mesh(plane.world(square), faces, uvs, faces),
        diffuse_albedo=plane.reflectance,
        specular_albedo=np.zeros(shape, np.float32),
        roughness=np.full(shape, 0.3, np.float32),
        normal=np.ascontiguousarray(normal),
        translucency=np.zeros(shape, np.float32),
        skin=np.ones(shape, bool),
    )


def test_a_board_is_drawn_where_the_worlds_rays_meet_its_mesh(rig, full, ball):
    """Same outline and pattern as a mesh of the same plane that the skin's renderer shows."""
    board = BoardConfig(texels_per_mm=4)
    pose = board_poses(rig, board, 2, 5)[0]
    plane = board.plane(pose)
    alone = dataclasses.replace(rig.scaled(0.5), cameras=rig.scaled(0.5).cameras[:1])
    light, depth = photograph_plane(plane, alone.cameras[0], lamps_of(rig), full, NO_ROOM)
    world = World(plane_subject(plane, ball), alone)
    surface = world.surfaces["cam0"]
    seen = surface.picture(np.ones(len(surface.pixel)))
    whole = cv2.erode(seen, np.ones((3, 3))) > 0
    assert not light[cv2.dilate(seen, np.ones((3, 3))) == 0].any()
    albedo = surface.picture(surface.albedo)[..., 1]
    # Away from edges of the print both see one texture, and light that varies slowly.
    even = cv2.dilate(albedo, np.ones((5, 5))) - cv2.erode(albedo, np.ones((5, 5))) < 1e-3
    ratio = light[whole & even][:, 1] / albedo[whole & even]
    assert ratio.min() > 0.5
    assert np.ptp(ratio) < 0.8
    position = surface.picture(surface.position)
    axis = rig.cameras[0].cam_from_world[2]
    np.testing.assert_allclose(depth[whole], position[whole] @ axis[:3] + axis[3], rtol=1e-4)


def test_a_planes_back_is_plain_and_a_plane_behind_the_camera_is_not_seen(rig, full):
    size = np.array([100.0, 80.0])
    away = facing(-rig.cameras[1].centre_mm, np.zeros(3), size)
    light, _ = photograph_plane(
        chart_plane(100.0, away), rig.cameras[1], lamps_of(rig), full, NO_ROOM
    )
    lit = light[light[..., 1] > 0][:, 1]
    assert np.quantile(lit, 0.9) < 0.05 * 1.6
    behind = facing(-rig.cameras[1].centre_mm, 2 * rig.cameras[1].centre_mm, size)
    light, depth = photograph_plane(
        chart_plane(100.0, behind), rig.cameras[1], lamps_of(rig), full, NO_ROOM
    )
    assert not light.any()
    assert not depth.any()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(1e-3, 3.0), st.floats(0.5, 2000.0))
def test_targets_anywhere_are_drawn_finite_and_never_negative(seed, tilt, size_mm):
    """Grazing, huge, tiny, half behind the camera: masked or finite."""
    rng = np.random.default_rng(seed)
    whole = default_rig().scaled(0.01)
    camera = whole.cameras[seed % 9]
    lamps = lamps_of(whole)
    toward = camera.centre_mm + 1100 * tilt * rng.standard_normal(3)
    middle = rng.uniform(-600, 600, 3)
    plane = chart_plane(size_mm, facing(toward, middle, np.array([size_mm, 0.67 * size_mm])))
    ball = Ball(middle, min(size_mm / 2, 200.0), 0.5)
    levels = rng.random(len(whole.lights))
    for light, depth in (
        photograph_plane(plane, camera, lamps, levels, NO_ROOM),
        photograph_grey(ball, camera, lamps, levels, NO_ROOM),
        photograph_mirror(ball, camera, lamps, levels, NO_ROOM),
    ):
        assert np.isfinite(light).all()
        assert np.isfinite(depth).all()
        assert light.min() >= 0
        assert depth.min() >= 0


def test_poses_and_truth_follow_the_seed(rig):
    first, again, other = (
        make_targets(rig, lamps_of(rig), CONFIG, CaptureFlaws(lens=LensConfig()), seed)
        for seed in (1, 1, 2)
    )
    assert first["charuco-01"].truth == again["charuco-01"].truth
    assert first["charuco-01"].truth != other["charuco-01"].truth
    assert first["charuco-00"].seen(rig.cameras[0])["places_px"]


def test_the_command_makes_targets_and_refuses_a_session_that_is_there(tmp_path):
    out, whole = tmp_path / "cal", default_rig()
    rig_file = str(
        save_rig(dataclasses.replace(whole, cameras=whole.cameras[:1]), tmp_path / "rig.json")
    )
    words = ["targets", "--rig", rig_file, "--out", str(out), "--scale", "0.005"]
    printed = CliRunner().invoke(app, [*words, "--flaws", "lab", "--json"])
    assert printed.exit_code == 0, printed.output
    facts = json.loads(printed.output.splitlines()[-1])
    session = load_session(out)
    assert facts["photographs"] == len(session.file.frames)
    assert {camera.dist[0] for camera in session.rig.cameras} == {-0.03}
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, SimError)
    assert "a session" in str(again.exception)
