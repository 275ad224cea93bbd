"""The rig: every fault named, projection against known geometry, the default rig as described."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import FormatError, RigError
from lightstage.rig import default_rig, load_rig, look_at, rig_to_json, save_rig
from tests.programs import run_program


def write(tmp_path, value):
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(value))
    return path


@pytest.fixture
def value(small_rig):
    return json.loads(json.dumps(rig_to_json(small_rig)))


def test_a_rig_survives_its_file(tmp_path, small_rig):
    read = load_rig(save_rig(small_rig, tmp_path / "rig.json"))
    assert read.lights == small_rig.lights
    for got, wanted in zip(read.cameras, small_rig.cameras, strict=True):
        assert np.array_equal(got.cam_from_world, wanted.cam_from_world)
        assert (got.id, got.fx_px, got.dist) == (wanted.id, wanted.fx_px, wanted.dist)


def test_the_default_rig_is_the_described_one():
    rig = default_rig()
    assert len(rig.lights) == 168
    assert len(rig.cameras) == 9
    for light in rig.lights:
        arc, place = divmod(light.id, 14)
        azimuth = np.radians(15 + 30 * arc)
        polar = np.radians((place + 0.5) * 180 / 14)
        expected = 1250 * np.array(
            [np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)]
        )
        assert np.allclose(light.position_mm, expected, atol=0.01)
    banks = [light.bank for light in rig.lights]
    assert banks.count("horizontal") == banks.count("vertical") == 84
    angles = [(0, 0), (-30, 0), (30, 0), (-60, 0), (60, 0), (0, 28), (0, -28), (-35, 25), (35, 25)]
    for camera, (azimuth_deg, elevation_deg) in zip(rig.cameras, angles, strict=True):
        azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
        place = 1100 * np.array(
            [
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
                np.cos(elevation) * np.cos(azimuth),
            ]
        )
        assert np.allclose(camera.centre_mm, place, atol=0.01)
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert np.allclose(pixel, [[camera.cx_px, camera.cy_px]], atol=0.01)
        assert depth == pytest.approx(1100, abs=0.01)


def addressed(value, *channels):
    """Give each light a channel, or none."""
    for light, channel in zip(value["lights"], channels, strict=True):
        if channel is not None:
            light["address"] = {"channel": channel}


FAULTS = {
    "two lights of one id": (
        lambda v: v["lights"][3].update(id=1),
        r"lamp 1 \(corner3\): found an id that corner1 has too, expected an id of its own",
    ),
    "a light at the origin": (
        lambda v: v["lights"][3].update(position_mm=[0, 0, 0]),
        r"lamp 3 \(corner3\).position_mm: found 0 mm from the origin, expected a lamp on",
    ),
    "metres": (lambda v: v["lights"][0].update(position_mm=[0.5, 0.5, 0.5]), "is it metres"),
    "NaN place": (lambda v: v["lights"][0].update(position_mm=[float("nan"), 0, 1]), "finite"),
    "a channel of two lights": (
        lambda v: addressed(v, 0, 1, 2, 3, 1, 5, 6, 7),
        r"lamp 4 \(corner4\).address: found channel 1, which lamp 1 \(corner1\) has, expected",
    ),
    "many channels of several lights": (
        lambda v: addressed(v, 0, 0, 2, 2, 4, 4, 6, 6),
        r"lamp 1 \(corner1\).address and 3 more: found channel 0",
    ),
    "addresses of some lights": (
        lambda v: addressed(v, 0, 1, None, 3, 4, 5, None, 7),
        r"lamp 2 \(corner2\).address: found none; 2 of 8 lamps have none",
    ),
    "a channel below the first": (
        lambda v: addressed(v, 0, 1, 2, 3, 4, 5, 6, -7),
        r"lights\[7\].address.channel: found -7, expected a whole number from 0",
    ),
    "an address that is a number": (lambda v: v["lights"][0].update(address=3), "an object"),
    "an address without a channel": (
        lambda v: v["lights"][0].update(address={"chanel": 3}),
        "no 'channel', expected it. Is 'chanel' misspelt",
    ),
    "a controller without a name": (
        lambda v: v["lights"][0].update(address={"channel": 0, "controller": " "}),
        r"lights\[0\].address.controller: found no name",
    ),
    "bank": (lambda v: v["lights"][0].update(bank="left"), "bank: found 'left', expected horiz"),
    "gain": (lambda v: v["lights"][0].update(rgb_gain=[1, -1, 1]), "rgb_gain"),
    "missing field": (lambda v: v["lights"][2].pop("name"), r"lights\[2\]: found no 'name'"),
    "no lights": (lambda v: v.update(lights=[]), "lights: found list, expected a non-empty list"),
    "no cameras": (lambda v: v.pop("cameras"), "cameras: found NoneType"),
    "two cameras of one id": (
        lambda v: v["cameras"][1].update(id="cam0"),
        "camera cam0: found the same id twice",
    ),
    "no focal length": (
        lambda v: v["cameras"][1].update(fy_px=-105),
        "camera cam1.fy_px: found -105, expected a focal length in pixels",
    ),
    "a pose with a scale": (
        lambda v: v["cameras"][1].update(
            cam_from_world=[[0.001, 0, 0, 0], [0, 0.001, 0, 0], [0, 0, 0.001, 0]]
        ),
        "no rotation: its rows have lengths of 0.001 to 0.001, .* Divide a scale out",
    ),
    "a pose of three decimals": (
        lambda v: v["cameras"][1].update(
            cam_from_world=[[0.985, 0, 0.174, 0], [0, 1, 0, 0], [-0.174, 0, 0.985, 0]]
        ),
        "rows have lengths of 1 to 1.00025, .* with six decimals",
    ),
    "a pose that shears": (
        lambda v: v["cameras"][1].update(
            cam_from_world=[[1, 0, 0, 0], [0.6, 0.8, 0, 0], [0, 0, 1, 0]]
        ),
        "no rotation: its rows are not at right angles, by 0.6",
    ),
    "mirrored": (
        lambda v: v["cameras"][1].update(
            cam_from_world=[[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
        ),
        "camera cam1.cam_from_world: found no rotation: it mirrors, .* x right, y down, z ahead",
    ),
    "a camera's id that leads elsewhere": (
        lambda v: v["cameras"][1].update(id="../X"),
        r"cameras\[1\].id: found '../X', expected a name",
    ),
    "an id with a NUL": (lambda v: v["cameras"][1].update(id="a\0"), "NUL"),
    "a misspelt field": (
        lambda v: v["cameras"][1].update(fx_pixel=v["cameras"][1].pop("fx_px")),
        r"cameras\[1\]: found no 'fx_px', expected it. Is 'fx_pixel' misspelt",
    ),
    "a picture of any size": (lambda v: v["cameras"][1].update(width_px=10**9), "1 to 65536"),
    "a whole number that is none": (lambda v: v["cameras"][1].update(width_px="32"), "width_px"),
    "a number beyond all": (lambda v: v["cameras"][1].update(fx_px=10**30), "number"),
    "a text that is none": (lambda v: v["lights"][1].update(name=["a"]), r"lights\[1\].name"),
    "a light that is none": (lambda v: v["lights"].append("on"), r"lights\[8\]: found 'on'"),
    "a gain that is none": (lambda v: v["lights"][1].update(rgb_gain=1), "3 finite numbers"),
    "a pose that is none": (lambda v: v["cameras"][1].update(cam_from_world=3), "3 rows of 4"),
    "pose size": (lambda v: v["cameras"][1].update(cam_from_world=[[1, 2], [3, 4]]), "cameras"),
    "schema": (lambda v: v.update(schema="lightstage.rig/2"), "newer version"),
    "other file": (lambda v: v.update(schema="lightstage.session/1"), "schema: found"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_of_a_rig_is_named(tmp_path, value, name):
    damage, message = FAULTS[name]
    damage(value)
    path = write(tmp_path, value)
    with pytest.raises(FormatError, match=message) as caught:
        load_rig(path)
    assert str(path) in str(caught.value)


def test_fields_that_others_added_are_kept_and_make_it_no_other_rig(tmp_path, value, small_rig):
    value["room"] = {"door": "left"}
    value["lights"][2]["shop"] = "5 mm"
    value["cameras"][1]["lens"] = [35, 1.4]
    read = load_rig(write(tmp_path, value))
    assert json.loads(save_rig(read, tmp_path / "again.json").read_text()) == value
    assert rig_to_json(read) == rig_to_json(small_rig)


def test_a_rigs_addresses_survive_its_file_with_what_others_added(tmp_path, value, small_rig):
    assert "address" not in value["lights"][0]
    assert [each.channel for each in small_rig.addresses] == list(range(8))
    addressed(value, 7, 6, 5, 4, 3, 2, 1, 0)
    value["lights"][2]["address"].update(controller="main", plug="B4")
    read = load_rig(write(tmp_path, value))
    assert [each.channel for each in read.addresses] == [7, 6, 5, 4, 3, 2, 1, 0]
    assert {each.controller for each in read.addresses} == {"main"}
    again = json.loads(save_rig(read, tmp_path / "again.json").read_text())
    assert again["lights"][2]["address"] == {"controller": "main", "channel": 5, "plug": "B4"}
    assert rig_to_json(read) != rig_to_json(small_rig)


def test_all_faults_of_a_rig_make_one_message(tmp_path, value):
    value["lights"][3]["id"] = 1
    value["lights"][5]["position_mm"] = [0, 0, 0]
    value["cameras"][2]["fx_px"] = -3
    with pytest.raises(RigError, match="3 problems"):
        load_rig(write(tmp_path, value))


@pytest.mark.parametrize("name", ["two lights of one id", "a light at the origin"])
def test_a_bad_rig_makes_a_command_exit_2_and_leave_nothing(tmp_path, value, name):
    damage, _ = FAULTS[name]
    damage(value)
    path = write(tmp_path, value)
    done = run_program("lightstage", "import", tmp_path, "--rig", path, "--out", tmp_path / "S")
    assert done.code == 2
    assert str(path) in done.err
    assert "Traceback" not in done.err
    assert [p.name for p in tmp_path.iterdir()] == ["rig.json"]


def test_a_camera_that_is_not_there_is_an_error_that_lists_those_that_are(small_rig):
    with pytest.raises(RigError, match="no cam9, expected one of cam0, cam1, cam2"):
        small_rig.camera("cam9")


finite = st.floats(-80, 80)


@given(st.lists(st.tuples(finite, finite, finite), min_size=1, max_size=8))
def test_projection_matches_opencv_with_distortion(points):
    camera = default_rig().cameras[3]
    camera = type(camera)(**{**camera.__dict__, "dist": (-0.2, 0.1, 0.001, -0.002, 0.03)})
    pixels, depth = camera.project(np.array(points))
    rotation, translation = camera.cam_from_world[:, :3], camera.cam_from_world[:, 3]
    expected, _ = cv2.projectPoints(
        np.array(points), cv2.Rodrigues(rotation)[0], translation, camera.opencv_matrix,
        np.array(camera.dist),
    )  # fmt: skip
    assert np.allclose(pixels, expected.reshape(-1, 2) + 0.5, atol=1e-5)
    assert (depth > 0).all()


def test_points_behind_a_camera_have_no_pixel(small_rig):
    camera = small_rig.cameras[0]
    pixels, depth = camera.project(np.array([2.0 * camera.centre_mm, [0, 0, 0]]))
    assert np.isnan(pixels[0]).all()
    assert depth[0] < 0 < depth[1]
    assert np.isfinite(pixels[1]).all()


@pytest.mark.parametrize("dist", [(0.0,) * 5, (-0.15, 0.05, 0.001, -0.001, 0.02)])
def test_pixel_rays_project_back_onto_their_pixels(small_rig, dist):
    camera = small_rig.cameras[2]
    camera = type(camera)(**{**camera.__dict__, "dist": dist})
    origin, directions = camera.pixel_rays()
    assert np.allclose(np.linalg.norm(directions, axis=-1), 1)
    pixels, _ = camera.project((origin + 900 * directions).reshape(-1, 3))
    columns, rows = np.meshgrid(np.arange(32) + 0.5, np.arange(48) + 0.5)
    assert np.allclose(pixels, np.stack([columns, rows], -1).reshape(-1, 2), atol=1e-4)


@given(st.tuples(finite, finite, st.floats(200, 2000)), st.tuples(finite, finite, finite))
def test_a_camera_that_looks_at_a_point_has_it_ahead_and_stands_upright(place, target):
    pose = look_at(np.array(place), np.array(target))
    rotation = pose[:, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
    local = rotation @ np.array(target) + pose[:, 3]
    assert np.allclose(local[:2], 0, atol=1e-6)
    assert local[2] > 0
    assert rotation[1] @ [0, 1, 0] < 0  # camera y points down
    assert np.allclose(-rotation.T @ pose[:, 3], place, atol=1e-6)


@pytest.mark.parametrize("factor", [0.1795, 0.09, 0.5, 2.0])
def test_a_scaled_rig_sees_the_same_directions(factor):
    camera = default_rig().cameras[7]
    small = default_rig().scaled(factor).cameras[7]
    points = np.random.default_rng(0).uniform(-100, 100, (20, 3))
    at_full = camera.project(points)[0] / [camera.width_px, camera.height_px]
    at_small = small.project(points)[0] / [small.width_px, small.height_px]
    assert np.allclose(at_full, at_small, atol=1e-12)
    assert small.width_px % 2 == small.height_px % 2 == 0
