"""What a body writes into a photograph's headers."""

import numpy as np
import pytest

from lightstage.exif import read_exif
from sim.camera.dng import Exif, dng_bytes
from sim.camera.exposure import expose_again, with_exposure
from sim.camera.sensor import Sensor, SensorConfig
from sim.errors import SimError


@pytest.fixture
def photograph():
    counts = np.full((8, 8), 1600, np.uint16)
    exif = Exif("Nikon DSC D750", "6012345", 16.0, 60.0)
    return dng_bytes(counts, Sensor(SensorConfig(), np.eye(3), 0.031), exif)


def read(tmp_path, data):
    path = tmp_path / "a.dng"
    path.write_bytes(data)
    return read_exif(path)


def test_a_bodys_settings_stand_in_the_headers_and_nothing_else_changes(photograph, tmp_path):
    values = {"iso": "400", "shutter": "1/60", "aperture": "f/5.6", "serial": "60177"}
    changed = with_exposure(photograph, **values, taken="2026:01:02 03:04:05")
    found = read(tmp_path, changed)
    assert (found.iso, found.exposure_s, found.f_number) == (400, pytest.approx(1 / 60), 5.6)
    assert found.serial == "60177"
    assert found.taken.isoformat() == "2026-01-02T03:04:05+00:00"
    assert len(changed) == len(photograph)
    assert changed[-128:] == photograph[-128:]
    assert with_exposure(photograph) == photograph


def test_a_text_with_seconds_is_a_time(photograph, tmp_path):
    found = read(tmp_path, with_exposure(photograph, shutter="0.0100s", aperture="f/2.8"))
    assert (found.exposure_s, found.f_number) == (0.01, 2.8)


def test_no_two_shots_of_one_light_are_the_same_bytes(photograph):
    assert len({with_exposure(photograph, shot=shot) for shot in range(1000)}) == 1000


def test_a_drifted_iso_shows_in_counts_and_headers(photograph, tmp_path):
    changed = expose_again(photograph, 4.0, "400")
    assert read(tmp_path, changed).iso == 400
    counts = np.frombuffer(changed[-128:], "<u2")
    assert set(counts) == {600 + 4 * 1000}


@pytest.mark.parametrize("data", [b"", b"no photograph", b"\xff\xd8\xff\xe0jpeg"])
def test_files_without_headers_come_back_as_they_were(data):
    assert with_exposure(data, iso="400", serial="1") == data


def test_what_does_not_fit_is_refused(photograph):
    with pytest.raises(SimError, match="at most 7 letters"):
        with_exposure(photograph, serial="12345678")


def test_names_and_places_left_in_a_camera_stand_in_its_files(tmp_path):
    exif = Exif("Nikon DSC D750", "1", 8.0, 60.0, artist="A. P", owner="A. P", place=(51.5, -0.17))
    sensor = Sensor(SensorConfig(), np.eye(3), 0.031)
    data = dng_bytes(np.full((8, 8), 1600, np.uint16), sensor, exif)
    assert read(tmp_path, data).private == ("Artist", "CameraOwnerName", "GPS")
