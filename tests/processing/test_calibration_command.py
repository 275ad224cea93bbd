"""`calibrate` on simulated targets whose every answer is known: charts, balls, flats, darks."""

from __future__ import annotations

import dataclasses
import json
import shutil
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from lightstage.errors import ConfigError, FormatError
from lightstage.formats.environment import stage_lights
from lightstage.formats.files import write_json
from lightstage.formats.flats import read_flats
from lightstage.formats.lights import MeasuredLights
from lightstage.formats.orientation import OF_TIFF
from lightstage.formats.session import Calibration, Session, load_session, save_session
from lightstage.session import read_calibration
from processing.__main__ import app
from processing.calibration.ball import rays_through, sphere_hits
from processing.calibration.colour.all_cameras import check_grey
from processing.calibration.colour.chart import chart_places_mm, find_chart
from processing.calibration.colour.white import white_at
from processing.calibration.config import CalibrateConfig
from processing.calibration.folder import read_source
from processing.calibration.output import make_calibration
from processing.calibration.picture import read_mosaic
from processing.calibration.stage import calibrate, lights_of
from processing.colour import read_colour
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode
from processing.errors import ProcessingError
from processing.frames.read import read_frames
from sim.camera.flaws import PRESETS
from sim.camera.optics import make_lens
from sim.light.lamps import LampConfig, lamps_of
from sim.targets import light as sim_light
from tests.processing.targets import make_lab, make_targets


@pytest.fixture(scope="module")
def targets(tmp_path_factory):
    return make_targets(tmp_path_factory.mktemp("targets") / "T", "lab")


@pytest.fixture(scope="module")
def truth(targets):
    return json.loads((targets.with_name("T.truth") / "targets.json").read_text())


@pytest.fixture(scope="module")
def found(targets):
    return calibrate(read_source(targets), CalibrateConfig())


def chart_of(targets, pose, camera):
    mosaic = read_mosaic(targets / f"frames/chart-{pose:02d}/{camera}.dng")
    return mosaic.cells(), mosaic.clipped_cells()


@pytest.mark.parametrize(("pose", "camera"), [(0, "cam0"), (0, "cam1"), (1, "cam1")])
def test_the_chart_is_found_where_it_is(targets, truth, pose, camera):
    view = find_chart(*chart_of(targets, pose, camera))
    stated = truth["targets"][f"chart-{pose:02d}"]
    places = np.array(stated["cameras"][camera]["places_px"]) / 2 - 0.5
    assert np.abs(view.places_px - places).max() < 0.5  # of patches 12 pixels wide
    assert view.grown >= 20
    pose_mm = np.array(stated["world_from_target"])
    known_mm = np.array(stated["places_mm"]) @ pose_mm[:, :2].T + pose_mm[:, 3]
    rig = load_session(targets).rig
    for pitch_mm in (None, stated["width_mm"] * 2.75 / 16.75):
        found_mm, normal = chart_places_mm(view, rig.camera(camera), pitch_mm)
        assert np.linalg.norm(found_mm - known_mm, axis=1).max() < 8
        assert normal @ -pose_mm[:, 2] > np.cos(np.radians(5))


def test_a_chart_upside_down_is_read_in_the_same_order(targets):
    rgb, clipped = chart_of(targets, 0, "cam0")
    upright = find_chart(rgb, clipped)
    turned = find_chart(np.ascontiguousarray(rgb[::-1, ::-1]), clipped[::-1, ::-1])
    np.testing.assert_allclose(turned.rgb, upright.rgb, rtol=0.02, atol=1e-4)


def test_where_there_is_no_chart_none_is_found():
    rng = np.random.default_rng(1)
    even = np.full((240, 360, 3), 0.4, np.float32)
    blobs = cv2.GaussianBlur(rng.uniform(0, 1, even.shape).astype(np.float32), (0, 0), 9)
    for picture in (even, blobs, np.zeros_like(even), even + rng.normal(0, 0.02, even.shape)):
        assert find_chart(picture.astype(np.float32), np.zeros((240, 360), bool)) is None


def test_what_white_reads_is_what_the_simulator_says(targets):
    rig = load_session(targets).rig
    lights = stage_lights(rig, np.ones(len(rig.lights)), "all", np.ones(len(rig.lights)))
    rng = np.random.default_rng(2)
    points = rng.uniform(-90, 90, (200, 3))
    normals = rng.standard_normal((200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lamps = lamps_of(rig, LampConfig(exponent=0.0))
    expected = sim_light.white_reading(points, normals, lamps, np.ones(len(rig.lights)))
    np.testing.assert_allclose(white_at(points, normals, lights), expected, rtol=1e-9, atol=1e-12)


def test_colours_are_absolute_albedo_through_vignetting_noise_and_unlike_lamps(found, truth):
    """White balance alone is 2.7 Delta E off; the fit below 0.1, and white within .5 %."""
    for name, correction in found.colours.items():
        facts = found.facts["colour"][name]
        assert facts["delta_e"]["white_balance_alone"] > 2
        assert facts["delta_e"]["mean"] < 0.1
        assert facts["reflectance_rms"] < 0.002
        assert facts["used"] == "matrix"  # the simulated sensor is linear
        factor = truth["targets"][facts["pose"].split(", ")[1]]["exposure_factor"]
        raw_from_linear = np.array(truth["sensors"][name]["raw_from_linear"]) * factor
        np.testing.assert_allclose(correction.matrix @ raw_from_linear, np.eye(3), atol=0.006)


def test_a_grey_ball_s_albedo_is_read_within_half_a_percent(found):
    assert found.facts["grey"]["largest_error"] < 0.005
    assert found.warnings == []


def test_vignetting_is_the_simulated_lens_s(found, targets):
    for camera in load_session(targets).rig.cameras:
        shading = make_lens(camera, PRESETS["lab"].lens, 3).shading
        off = found.flats[camera.id].gain(shading.shape) * shading - 1
        assert shading.min() < 0.85
        assert np.abs(off).max() < 0.003
        assert np.abs(found.flats[camera.id].black_offset).max() < 5e-6
        assert len(found.flats[camera.id].hot_pixels) == 0


def test_lamps_are_measured_from_balls_without_the_lens_s_vignetting(targets, monkeypatch):
    """An even card in a ball's place shows what is left of the lens."""
    source = read_source(targets)
    grey = dataclasses.replace(source.poses["grey"][0], patterns=("grey-00", "flat-00"))
    poses = {"flat": source.poses["flat"], "grey": [grey]}
    with monkeypatch.context() as patched:
        fit = MagicMock()
        patched.setattr("processing.calibration.stage.fit_lights", fit)
        calibrate(dataclasses.replace(source, poses=poses), CalibrateConfig())
    (shots,) = fit.call_args.args[2]
    card = shots.read("flat-00", "cam0").rgb.mean(axis=2)
    patches = cv2.resize(card, (4, 6), interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(patches / patches.mean(), 1, atol=0.01)


def test_colours_may_be_scaled_to_the_grey_ball(targets, found):
    config = CalibrateConfig()
    grey = dataclasses.replace(config.grey, reflectance=0.2, sets_the_scale=True)
    scaled = calibrate(read_source(targets), dataclasses.replace(config, grey=grey))
    for name, correction in scaled.colours.items():
        ratio = correction.matrix / found.colours[name].matrix
        np.testing.assert_allclose(ratio, 0.2 / 0.18, rtol=0.005)
    assert "grey ball reads" in scaled.warnings[-1]


def test_a_grey_ball_in_pictures_of_another_size_is_refused(targets, found):
    pose = read_source(targets).poses["grey"][0]
    rig = pose.session.rig
    cameras = tuple(dataclasses.replace(c, width_px=c.width_px + 8) for c in rig.cameras)
    wider = dataclasses.replace(rig, cameras=cameras)
    session = Session(pose.session.root, pose.session.file, wider)
    other = dataclasses.replace(pose, session=session)
    shone = lights_of(other, found.full_levels, found.lights)
    with pytest.raises(FormatError, match=r"grey-00/cam\d\.dng: found \d+ x \d+ pixels, expected"):
        check_grey(other, found.colours, found.flats, shone, CalibrateConfig().grey)


def test_a_reflectance_in_per_cent_is_refused(targets, tmp_path):
    config = tmp_path / "c.toml"
    config.write_text("[grey]\nreflectance = 18\nsets_the_scale = true\n")
    out = tmp_path / "out"
    done = CliRunner().invoke(
        app, ["calibrate", str(targets), "--out", str(out), "--config", str(config)]
    )
    assert isinstance(done.exception, ConfigError)
    assert "grey.reflectance: found 18.0, expected from 0.01 to 1" in str(done.exception)
    assert not out.exists()


def test_the_command_writes_a_folder_that_a_session_can_carry(targets, found, tmp_path):
    lab = make_lab(targets, tmp_path / "LAB")
    out = tmp_path / "CALIBRATION"
    config = tmp_path / "c.toml"
    config.write_text("[flat]\nper_pixel = true\n")
    arguments = ["calibrate", str(lab), "--out", str(out), "--config", str(config), "--json"]
    for _ in range(2):  # made, and replaced
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout.splitlines()[-1])
    assert facts["colour"]["cam0"]["pose"] == "chart-20260101T000000Z/pose-01, full"
    rig = load_session(targets).rig
    names = [camera.id for camera in rig.cameras]
    colours = read_colour(out / "colour.json", names)
    for name in names:
        # Flats of one photograph a camera in place of two.
        np.testing.assert_allclose(colours[name].matrix, found.colours[name].matrix, atol=0.01)
        assert colours[name].exposure == pytest.approx(found.colours[name].exposure)
    assert read_flats(out / "flats.json", names)["cam1"].per_pixel is not None
    assert cv2.imread(str(out / "chart-cam0.png")).shape[2] == 3
    kept = json.loads((out / "calibration.json").read_text())
    assert kept["config"]["flat"]["per_pixel"] is True
    assert set(kept["source"]) == {"chart", "grey", "flat", "dark"}
    carried = read_calibration(out, rig)
    assert carried.colour["full_levels"] == [1.0] * len(rig.lights)
    assert set(carried.beside) == {"flats.json", "flats-cam0.npz", "flats-cam1.npz"}
    (out / "letters.txt").write_text("mine")
    with pytest.raises(FormatError, match=r"CALIBRATION: found letters\.txt, which the command"):
        make_calibration(read_source(lab), CalibrateConfig(), out)
    assert (out / "letters.txt").read_text() == "mine"


def test_the_newest_finished_shots_count(targets, tmp_path):
    lab = make_lab(targets, tmp_path / "LAB", "20250101T000000Z")
    make_lab(targets, lab, "20260101T000000Z")
    begun = lab / "chart-20270101T000000Z"
    shutil.copytree(lab / "chart-20260101T000000Z", begun)
    value = json.loads((begun / "calibration.json").read_text())
    value |= {"created_utc": "2027-01-01T00:00:00+00:00", "finished_utc": None}
    (begun / "calibration.json").write_text(json.dumps(value))
    # A result may be in the lab: it is no shots.
    write_json(lab / "result" / "calibration.json", {"schema": "lightstage.calibration/1"})
    source = read_source(lab)
    assert {facts["folder"][-16:] for facts in source.facts.values()} == {"20260101T000000Z"}
    assert source.warnings == []


def test_shots_are_never_replaced_by_a_result(targets, tmp_path):
    lab = make_lab(targets, tmp_path / "LAB")
    for out in sorted(lab.iterdir()):
        before = sorted(out.rglob("*"))
        with pytest.raises(FormatError, match=r"lightstage\.calibration-shots/1"):
            make_calibration(read_source(lab), CalibrateConfig(), out)
        assert sorted(out.rglob("*")) == before


def test_photographs_that_are_not_those_that_were_taken_are_refused(targets, tmp_path):
    lab = make_lab(targets, tmp_path / "LAB")
    for pose in ("chart-20260101T000000Z/pose-02", "dark-20260101T000000Z/pose-01"):
        path = lab / pose / "session.json"
        path.write_text(path.read_text().replace('"none"', '"smile"'))
    with pytest.raises(FormatError, match=r"(?s)2 problems.*chart-.*pose-02.*dark-.*pose-01"):
        read_source(lab)


def test_every_camera_without_a_chart_is_named(targets, tmp_path):
    lab = make_lab(targets, tmp_path / "LAB")
    root = lab / "chart-20260101T000000Z"
    for pose, camera in (("pose-01", "cam0"), ("pose-02", "cam1")):
        flat = lab / f"flat-20260101T000000Z/{pose}/frames/full/{camera}.dng"
        shutil.copyfile(flat, root / pose / f"frames/full/{camera}.dng")
    with pytest.raises(ProcessingError, match=r"(?s)cam0: found no colour chart.*cam1: found no"):
        calibrate(read_source(lab), CalibrateConfig())


def test_what_cannot_be_calibrated_ends_with_2_and_writes_nothing(targets, tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "letter.txt").write_text("dear")
    empty = tmp_path / "LAB"
    empty.mkdir()
    for lab, out in ((tmp_path / "none", tmp_path / "C"), (empty, tmp_path / "C")):
        result = CliRunner().invoke(app, ["calibrate", str(lab), "--out", str(out)])
        assert isinstance(result.exception, FormatError)
        assert not out.exists()
    result = CliRunner().invoke(app, ["calibrate", str(targets), "--out", str(mine)])
    assert isinstance(result.exception, FormatError)
    assert [path.name for path in mine.iterdir()] == ["letter.txt"]


def test_a_session_that_carries_the_calibration_decodes_to_absolute_albedo(targets, tmp_path):
    """The whole way: through vignetting, and from another exposure than the chart's."""
    lab = make_lab(targets, tmp_path / "LAB")
    out = tmp_path / "CALIBRATION"
    assert CliRunner().invoke(app, ["calibrate", str(lab), "--out", str(out)]).exit_code == 0
    root = lab / "grey-20260101T000000Z/pose-01"
    shutil.copytree(out, root / "calibration")
    session = load_session(root)
    kinds = {kind: f"calibration/{kind}.json" for kind in ("colour", "flats")}
    save_session(root, session.file.model_copy(update={"calibration": Calibration(**kinds)}))
    session = load_session(root)
    facts = decode(session, tmp_path / "OUT", DecodeConfig())
    assert facts["warnings"] == []
    rig = session.rig
    lights = stage_lights(rig, np.ones(len(rig.lights)), "all", np.ones(len(rig.lights)))
    for camera in rig.cameras:
        frames = read_frames(tmp_path / "OUT", camera.id)
        seen = frames.valid
        rows, columns = np.nonzero(seen)
        rays = rays_through(camera, np.stack([columns, rows], axis=1) + 0.5)
        points, hit = sphere_hits(np.zeros(3), 38.1, camera.centre_mm, rays)
        normals = points / 38.1
        front = hit & (-np.einsum("nk,nk->n", normals, rays) > 0.6)
        albedo = frames.pixels(seen)[front, 0] / white_at(points[front], normals[front], lights)
        assert front.sum() > 1000
        np.testing.assert_allclose(np.median(albedo, axis=0), 0.18, rtol=0.01)


def test_a_photograph_on_its_side_is_read_upright(targets, tmp_path):
    """The same counts, told by EXIF to want a quarter turn: the same chart, in its order."""
    path = targets / "frames/chart-00/cam0.dng"
    entry = bytes([0x12, 0x01, 3, 0, 1, 0, 0, 0])  # tag 274, SHORT, one value
    data = path.read_bytes()
    assert data.count(entry + b"\x01\x00") == 1
    side = tmp_path / "side.dng"
    side.write_bytes(data.replace(entry + b"\x01\x00", entry + b"\x06\x00"))
    read, turned = read_mosaic(path), read_mosaic(side)
    assert turned.orientation == OF_TIFF[6]
    np.testing.assert_array_equal(turned.level, np.rot90(read.level, -1))
    np.testing.assert_array_equal(turned.as_read().level, read.level)
    np.testing.assert_array_equal(turned.as_read().channels, read.channels)
    upright = find_chart(read.cells(), read.clipped_cells())
    found = find_chart(turned.cells(), turned.clipped_cells())
    np.testing.assert_allclose(found.rgb, upright.rgb, rtol=0.03, atol=1e-4)


def test_measured_lamps_tell_what_white_reads_where_the_rig_s_own_gains_do_not(targets):
    source = read_source(targets)
    rig = load_session(targets).rig
    full = np.ones(len(rig.lights))
    lamps = lamps_of(rig, LampConfig(gain_spread=0.2, colour_spread=0.1, exponent=0.0), 3)
    gains = lamps.weights / lamps_of(rig).weights
    count = len(rig.lights)
    measured = MeasuredLights(
        position_mm=rig.positions_mm,
        rgb_gain=gains * [2.0, 1.0, 0.5],  # of channels only the ratios between lamps are known
        exponent=0.0,
        stray={},
        position_sigma_mm=np.zeros(count),
        residual_px=np.zeros(count),
        gain_sigma=np.zeros(count),
        facts={},
    )
    pose = source.poses["chart"][1]
    rng = np.random.default_rng(6)
    points, normals = rng.uniform(-90, 90, (100, 3)), rng.standard_normal((100, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    front = sim_light.white_reading(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), lamps, full)
    expected = sim_light.white_reading(points, normals, lamps, full) / front
    found = white_at(points, normals, lights_of(pose, full, (measured, rig)))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    nominal = white_at(points, normals, lights_of(pose, full, None))
    assert np.abs(nominal / expected - 1).max() > 0.05
