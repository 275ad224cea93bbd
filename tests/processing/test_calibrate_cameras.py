import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from benchmarks.geometry_poses import as_written
from lightstage.errors import ConfigError
from lightstage.formats.board import BoardConfig
from lightstage.formats.files import read_json
from lightstage.rig import Rig, default_rig, load_rig
from processing.__main__ import app
from processing.calibration.cameras.boards import find_board
from processing.calibration.cameras.config import CamerasConfig
from processing.calibration.cameras.fit import adjust, residuals
from processing.calibration.cameras.measured import MeasuredCameras, measure_cameras
from processing.calibration.cameras.output import CamerasFile, camera_settings, make_cameras
from processing.calibration.folder import Source
from processing.errors import PoseError, ProcessingError
from sim.camera.flaws import CaptureFlaws
from sim.light.lamps import lamps_of
from sim.targets import target_session
from sim.targets.boards import BoardConfig as PrintedBoard
from sim.targets.boards import board_poses, facing
from sim.targets.plane import photograph_plane
from tests.processing.boards_seen import BOARD, pose_errors, sights_of

CONFIG = CamerasConfig()


@pytest.fixture(scope="module")
def true_rig() -> Rig:
    rig = default_rig().scaled(0.25)
    bent = [
        dataclasses.replace(camera, dist=(0.05, 0, 0, 0, 0), cx_px=camera.cx_px + 4)
        for camera in rig.cameras[:5]
    ]
    return dataclasses.replace(rig, cameras=tuple(bent))


@pytest.fixture(scope="module")
def written(true_rig: Rig) -> Rig:
    return as_written(true_rig, 1)


@pytest.fixture(scope="module")
def measured(true_rig: Rig, written: Rig) -> MeasuredCameras:
    return measure_cameras(sights_of(true_rig, 20, 2), written, BOARD, CONFIG)


def test_poses_and_lenses_come_back(true_rig: Rig, written: Rig, measured: MeasuredCameras) -> None:
    found = dataclasses.replace(true_rig, cameras=measured.cameras)
    before_deg, before_mm = pose_errors(written, true_rig)
    after_deg, after_mm = pose_errors(found, true_rig)
    assert np.median(after_deg) < 0.02 < np.median(before_deg)
    assert np.median(after_mm) < 0.1 < np.median(before_mm)
    for camera, true in zip(measured.cameras, true_rig.cameras, strict=True):
        assert camera.fx_px == pytest.approx(true.fx_px, rel=5e-4)
        assert camera.dist[0] == pytest.approx(0.05, abs=0.03)
        facts = measured.facts["cameras"][camera.id]
        assert facts["residual_px"] < 0.1
        assert facts["held_out_px"] < 0.1
    assert measured.warnings == []


def test_the_world_is_the_rigs_own(written: Rig, measured: MeasuredCameras) -> None:
    centres = np.array([camera.centre_mm for camera in measured.cameras])
    there = np.array([camera.centre_mm for camera in written.cameras])
    # Cameras are written down 3 mm off on each axis; the whole may not drift beside that.
    assert np.linalg.norm((centres - there).mean(axis=0)) < 4
    assert np.linalg.norm(centres - there, axis=1).max() < 15


def test_a_camera_that_moved_between_boards_is_named_and_refused(
    true_rig: Rig, written: Rig
) -> None:
    sights = sights_of(true_rig, 9, 2)
    bad = [
        dataclasses.replace(s, pixels=s.pixels + np.array([6.0 * (s.shot % 3), 0]))
        if s.camera == "cam3"
        else s
        for s in sights
    ]
    with pytest.raises(PoseError, match=r"cam3 \(\d+\.\d+ px\): found") as caught:
        measure_cameras(bad, written, BOARD, CONFIG)
    assert "cam1" not in str(caught.value)
    kept = measure_cameras(bad, written, BOARD, dataclasses.replace(CONFIG, allow=("cam3",)))
    assert any("cam3" in warning and "allowed" in warning for warning in kept.warnings)


def test_wrong_corners_count_little(true_rig: Rig, written: Rig) -> None:
    rng = np.random.default_rng(4)
    wrong = []
    for sight in sights_of(true_rig, 12, 2):
        pixels = sight.pixels.copy()
        some = rng.random(len(pixels)) < 0.05
        pixels[some] += rng.normal(0, 30, (some.sum(), 2))
        wrong.append(dataclasses.replace(sight, pixels=pixels))
    found = measure_cameras(wrong, written, BOARD, CONFIG)
    after_deg, after_mm = pose_errors(
        dataclasses.replace(true_rig, cameras=found.cameras), true_rig
    )
    assert np.median(after_deg) < 0.03
    assert np.median(after_mm) < 0.15


def test_swapped_cameras_are_warned_of(true_rig: Rig, written: Rig) -> None:
    names = {"cam1": "cam4", "cam4": "cam1"}
    swapped = [
        dataclasses.replace(s, camera=names.get(s.camera, s.camera))
        for s in sights_of(true_rig, 12, 2)
    ]
    found = measure_cameras(swapped, written, BOARD, CONFIG)
    assert any(
        "cam1" in warning and "where rig.json has cam4" in warning for warning in found.warnings
    )
    assert any(
        "cam4" in warning and "where rig.json has cam1" in warning for warning in found.warnings
    )


def test_too_few_boards_and_cameras_that_share_none(true_rig: Rig, written: Rig) -> None:
    with pytest.raises(PoseError, match="0 boards seen"):
        measure_cameras([], written, BOARD, CONFIG)
    sights = [s for s in sights_of(true_rig, 12, 2) if s.camera != "cam2"]
    found = measure_cameras(sights, written, BOARD, CONFIG)
    assert found.cameras[2] == written.cameras[2]
    assert any(warning.startswith("cam2 was not measured") for warning in found.warnings)
    with pytest.raises(PoseError, match="model"):
        measure_cameras(sights, written, BOARD, dataclasses.replace(CONFIG, model="FISHEYE"))


def test_residuals_are_those_of_a_plain_projection(true_rig: Rig) -> None:
    sights = sights_of(true_rig, 3, 7, 0.0)
    cameras = {camera.id: camera for camera in true_rig.cameras}
    boards = {shot: np.eye(4)[:3] for shot in range(3)}
    found = residuals(sights, BOARD.corners_mm(), cameras, boards)
    sight = sights[0]
    pose = cameras[sight.camera].cam_from_world
    for corner, pixel, miss in zip(sight.ids, sight.pixels, found[0], strict=True):
        x, y, z = pose[:, :3] @ BOARD.corners_mm()[corner] + pose[:, 3]
        bend = 1 + 0.05 * ((x / z) ** 2 + (y / z) ** 2)
        lens = cameras[sight.camera]
        u, v = lens.fx_px * x / z * bend + lens.cx_px, lens.fy_px * y / z * bend + lens.cy_px
        assert miss == pytest.approx(np.hypot(u - pixel[0], v - pixel[1]), rel=1e-9)


@settings(max_examples=10, deadline=None)
@given(st.sampled_from(["SIMPLE_RADIAL", "RADIAL", "OPENCV"]), st.integers(0, 1000))
def test_adjusting_never_makes_it_worse(model: str, seed: int) -> None:
    rig = default_rig().scaled(0.25)
    rig = dataclasses.replace(rig, cameras=rig.cameras[:3])
    sights = sights_of(rig, 6, seed)
    first = np.eye(4)
    first[:3] = rig.cameras[0].cam_from_world
    start = as_written(rig, seed, 1.0, 0.1)
    cameras = {
        c.id: dataclasses.replace(c, cam_from_world=(c.cam_from_world @ np.linalg.inv(first))[:3])
        for c in start.cameras
    }
    held = board_poses(rig, PrintedBoard(), 6, seed)
    boards = {k: (first @ np.vstack([p, [0, 0, 0, 1]]))[:3] for k, p in enumerate(held)}
    before = np.concatenate(residuals(sights, BOARD.corners_mm(), cameras, boards))
    after = np.concatenate(
        adjust(sights, BOARD.corners_mm(), cameras, boards, model=model).residual_px
    )
    assert np.median(after) <= np.median(before)
    assert np.isfinite(after).all()


def test_how_sure_a_cameras_place_is_is_reported(
    true_rig: Rig, written: Rig, measured: MeasuredCameras
) -> None:
    found = dataclasses.replace(true_rig, cameras=measured.cameras)
    off_mm = pose_errors(found, true_rig)[1]
    facts = np.array([measured.facts["cameras"][c.id]["place_sigma_mm"] for c in true_rig.cameras])
    assert 0.4 < np.sqrt((facts**2).mean() / (off_mm**2).mean()) < 2.5
    assert not measured.warnings
    strict = dataclasses.replace(CONFIG, unsure_mm=1e-4)
    warned = measure_cameras(sights_of(true_rig, 12, 2), written, BOARD, strict).warnings
    assert [text.split(" ")[0] for text in warned] == [c.id for c in true_rig.cameras]
    assert "nearer and farther" in warned[0]


def test_a_camera_that_saw_too_few_boards_is_warned_of(true_rig: Rig, written: Rig) -> None:
    every = sights_of(true_rig, 20, 2)
    names = [camera.id for camera in true_rig.cameras]
    seen = {name: [s.shot for s in every if s.camera == name] for name in names}
    few, never = names[0], names[1]
    kept = [s for s in every if s.camera != never]
    kept = [s for s in kept if s.camera != few or s.shot in seen[few][:3]]
    found = measure_cameras(kept, written, BOARD, CONFIG)
    assert (found.unmeasured, found.unchecked) == ([never], [few])
    warning = {warning.split(" ")[0]: warning for warning in found.warnings}
    assert "keeps the lens and pose that it had" in warning[never]
    assert "3 boards alone" in warning[few]
    assert "could not be checked" in warning[few]


def test_a_board_that_is_seen_as_one_row_of_corners_stops_nothing(
    true_rig: Rig, written: Rig
) -> None:
    sights = list(sights_of(true_rig, 12, 4))
    corners_mm = BOARD.corners_mm()
    row = np.flatnonzero(np.isclose(corners_mm[:, 1], corners_mm[0, 1]))
    last = sights[-1]
    held = np.isin(last.ids, row)
    assert held.sum() >= 4
    sights[-1] = dataclasses.replace(last, ids=last.ids[held], pixels=last.pixels[held])
    found = measure_cameras(sights, written, BOARD, CONFIG)
    degrees, _ = pose_errors(dataclasses.replace(written, cameras=found.cameras), true_rig)
    assert degrees.max() < 0.5


def test_a_few_corners_far_off_push_no_camera(true_rig: Rig, written: Rig) -> None:
    sights = []
    for number, sight in enumerate(sights_of(true_rig, 20, 2, 0.01)):
        # A third of every fifth board to one side, as where a shadow's edge lies across it.
        bad = (sight.ids < 25) & (number % 5 == 0)
        moved = sight.pixels + bad[:, None] * np.array([0.4, 0.3])
        sights.append(dataclasses.replace(sight, pixels=moved))
    cameras = measure_cameras(sights, written, BOARD, CONFIG).cameras
    degrees, off_mm = pose_errors(dataclasses.replace(true_rig, cameras=cameras), true_rig)
    assert off_mm.max() < 0.1
    assert degrees.max() < 0.01


def test_corners_of_a_photographed_board_are_found_to_a_fiftieth_of_a_pixel() -> None:
    rig = default_rig().scaled(0.2)
    camera = rig.cameras[1]
    printed = PrintedBoard()
    size = np.array([printed.columns, printed.rows]) * printed.square_mm
    pose = facing(camera.centre_mm + np.array([200, 150, 0]), np.zeros(3), size)
    lamps = lamps_of(rig)
    light, _ = photograph_plane(
        printed.plane(pose), camera, lamps, np.ones(len(lamps.weights)), np.zeros(3)
    )
    noisy = light.mean(axis=2) + np.random.default_rng(0).normal(0, 0.002, light.shape[:2])
    ids, pixels = find_board(noisy, BOARD.board())
    assert len(ids) > 60
    shown, _ = camera.project(BOARD.corners_mm()[ids] @ pose[:, :3].T + pose[:, 3])
    assert np.median(np.linalg.norm(pixels - shown, axis=1)) < 0.02
    for empty in (np.zeros((200, 300)), np.full((200, 300), np.nan), np.full((200, 300), 0.5)):
        assert len(find_board(empty, BOARD.board())[0]) == 0


def test_boards_that_opencv_cannot_make_are_refused() -> None:
    with pytest.raises(ConfigError, match="DICT_4X4_50"):
        dataclasses.replace(BOARD, dictionary="CharucoBoard").board()
    with pytest.raises(ConfigError, match="markers smaller than squares"):
        BoardConfig(square_mm=10.0, marker_mm=12.0).board()


def test_the_command_writes_a_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = target_session.make_targets

    def boards_alone(*given: Any) -> dict[str, target_session.Target]:
        return {name: one for name, one in every(*given).items() if name.startswith("charuco")}

    monkeypatch.setattr(target_session, "make_targets", boards_alone)
    rig = default_rig().scaled(0.2)
    rig = dataclasses.replace(rig, cameras=rig.cameras[:3])
    config = target_session.TargetsConfig(board_poses=5)
    target_session.write_targets(
        rig, tmp_path / "targets", config, CaptureFlaws(), 5, lambda *_: None
    )
    arguments = ["calibrate-cameras", str(tmp_path / "targets"), "--out", str(tmp_path / "out")]
    printed = CliRunner().invoke(app, [*arguments, "--json"])
    assert printed.exit_code == 0, printed.output
    printed = json.loads(printed.stdout.splitlines()[-1])
    assert set(printed["cameras"]) == {"cam0", "cam1", "cam2"}
    found = load_rig(tmp_path / "out" / "rig.json")
    degrees, shift = pose_errors(found, rig)
    assert degrees.max() < 0.5
    assert shift.max() < 3
    assert read_json(tmp_path / "out" / "cameras.json", "lightstage.cameras/1")["facts"]
    # A session's folder of calibrations has a cameras.json, too.
    (tmp_path / "out" / "colour.json").write_text("{}")
    again = CliRunner().invoke(app, arguments)
    assert again.exit_code != 0
    assert (tmp_path / "out" / "colour.json").read_text() == "{}"


def test_the_board_is_that_of_the_shots_where_the_settings_do_not_say_otherwise(
    tmp_path: Path,
) -> None:
    target = dataclasses.asdict(dataclasses.replace(BOARD, square_mm=25.0, columns=9))
    source = Source(tmp_path, {}, {"charuco": {"folder": "charuco-1", "target": target}}, [])
    assert camera_settings(source, {}, "defaults").board == BoardConfig(columns=9, square_mm=25.0)
    named = {"board": {"square_mm": 24.9}, "cameras": {"min_sights": 4}}
    found = camera_settings(source, named, "cameras.toml")
    assert found.board == BoardConfig(columns=9, square_mm=24.9)
    assert found.cameras.min_sights == 4
    for values in ({"board": {"squares": 3}}, {"board": 3}):
        with pytest.raises(ConfigError, match=r"cameras\.toml"):
            camera_settings(source, values, "cameras.toml")
    source.facts["charuco"]["target"] = {"columns": "many"}
    with pytest.raises(ConfigError, match=r"charuco-1/calibration\.json, target"):
        camera_settings(source, {}, "defaults")
    # Targets in one session tell nothing of the board.
    assert camera_settings(Source(tmp_path, {}, {}, []), {}, "defaults") == CamerasFile()


def test_shots_without_a_board_are_refused(tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    source = Source(tmp_path / "lab", {"dark": []}, {}, [])
    with pytest.raises(ProcessingError, match="shots of dark, expected shots of a ChArUco"):
        make_cameras(source, CamerasFile(), tmp_path / "out")
    assert not (tmp_path / "out").exists()
