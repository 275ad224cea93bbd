"""A calibration folder that a session carries: whole, or refused before anything is made."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.formats.files import write_json
from lightstage.formats.flats import FlatField, write_flats
from lightstage.formats.session import load_session
from lightstage.session import SessionWriter, read_calibration


@pytest.fixture
def folder(tmp_path, small_rig):
    path = tmp_path / "CALIBRATION"
    eye = np.eye(3).tolist()
    cameras = {camera.id: {"linear_from_raw": eye} for camera in small_rig.cameras}
    write_json(path / "colour.json", {"schema": "lightstage.colour/1", "cameras": cameras})
    flats = {camera.id: FlatField.even(camera) for camera in small_rig.cameras}
    gains = np.ones(flats["cam0"].size_px[::-1], np.float32)
    flats["cam0"] = dataclasses.replace(flats["cam0"], per_pixel=gains)
    write_flats(flats, path / "flats.json", {})
    lights = [
        {"id": light.id, "position_mm": list(light.position_mm), "rgb_gain": [1, 1, 1]}
        for light in small_rig.lights
    ]
    values = {"position_sigma_mm": 1.0, "residual_px": 0.1, "gain_sigma": 0.01}
    value = {"schema": "lightstage.lights/1", "exponent": 0.0, "stray": {}, "facts": {}}
    value["lights"] = [{**light, **values} for light in lights]
    write_json(path / "lights.json", value)
    return path


def test_a_session_carries_colours_flats_and_lights_from_its_first_line_on(
    tmp_path, fill, small_rig, plan, folder
):
    carried = read_calibration(folder, small_rig)
    writer = SessionWriter.new(
        tmp_path / "S", small_rig, plan, colour=carried.colour, beside=carried.beside
    )
    writer.close()
    writer = SessionWriter.resumed(tmp_path / "S")
    writer.resume({}, {})
    fill(writer)
    writer.finish()
    stated = load_session(writer.root).file.calibration.model_dump()
    writer.close()
    for kind in ("colour", "flats", "lights"):
        assert stated[kind] == f"calibration/{kind}.json"
        assert json.loads((tmp_path / "S" / stated[kind]).read_text()) == json.loads(
            (folder / f"{kind}.json").read_text()
        )
    gains = (folder / "flats-cam0.npz").read_bytes()
    assert (tmp_path / "S/calibration/flats-cam0.npz").read_bytes() == gains


def test_a_folder_may_hold_some_of_the_files(small_rig, folder):
    (folder / "colour.json").unlink()
    (folder / "lights.json").unlink()
    carried = read_calibration(folder, small_rig)
    assert carried.colour is None
    assert set(carried.beside) == {"flats.json", "flats-cam0.npz"}


@pytest.mark.parametrize("name", ["../flats-cam0.npz", "missing.npz", 7])
def test_flats_that_name_a_file_that_is_not_beside_them_are_refused(small_rig, folder, name):
    value = json.loads((folder / "flats.json").read_text())
    value["cameras"]["cam0"]["per_pixel"] = name
    write_json(folder / "flats.json", value)
    with pytest.raises(FormatError, match=r"flats\.json"):
        read_calibration(folder, small_rig)


def test_flats_of_another_picture_size_are_refused_before_anything_is_made(small_rig, folder):
    value = json.loads((folder / "flats.json").read_text())
    camera = small_rig.cameras[0]
    # A sensor may lie where its pictures stand upright.
    sizes = {"height_px": camera.width_px, "width_px": camera.height_px}
    value["cameras"]["cam0"] |= {**sizes, "per_pixel": None}
    write_json(folder / "flats.json", value)
    read_calibration(folder, small_rig)
    value["cameras"]["cam0"] |= {"height_px": 2 * camera.width_px}
    write_json(folder / "flats.json", value)
    with pytest.raises(FormatError, match=r"cameras\.cam0: found flats of .* pixels, expected"):
        read_calibration(folder, small_rig)


@pytest.mark.parametrize("change", [{"radius_px": -1}, {"hot_pixels": [[48, 0]]}])
def test_flats_that_processing_could_not_use_are_refused(small_rig, folder, change):
    value = json.loads((folder / "flats.json").read_text())
    value["cameras"]["cam1"] |= change
    write_json(folder / "flats.json", value)
    with pytest.raises(FormatError, match=r"flats\.json, cameras: found no usable flat of cam1"):
        read_calibration(folder, small_rig)


def test_an_empty_folder_is_no_calibration(tmp_path, small_rig):
    (tmp_path / "nothing").mkdir()
    with pytest.raises(FormatError, match=r"no colour\.json"):
        read_calibration(tmp_path / "nothing", small_rig)
