"""Whether a photograph is whose and what it is taken for, from its own headers."""

import dataclasses
import datetime

import numpy as np
import pytest

from lightstage.cameras.camera import Summary
from lightstage.errors import CaptureError
from lightstage.formats.exr import write_exr
from lightstage.preflight import photograph_findings
from sim.camera import dng
from sim.camera.sensor import Sensor, SensorConfig

TOLD = Summary(iso="100", shutter="1/60", aperture="f/8")
EXPOSED = datetime.datetime(2026, 3, 4, 5, 6, 7, tzinfo=datetime.UTC)


@pytest.fixture
def photograph(tmp_path):
    def make(
        iso=100, exposure_s=1 / 60, f_number=8.0, serial="600", model="Nikon DSC D750", **exif
    ):
        sensor = Sensor(SensorConfig(iso=iso), np.eye(3), exposure_s)
        path = tmp_path / "cam0.dng"
        own = dng.Exif(model, serial, f_number, 60.0, **exif)
        path.write_bytes(dng.dng_bytes(np.full((48, 32), 700, np.uint16), sensor, own))
        return path

    return make


def look(path, rig, told=TOLD, **when):
    found = photograph_findings(path, rig.cameras[0], told, **when)
    assert all(f.camera == "cam0" for f in found)
    return [(f.severity, f.code) for f in found]


def test_a_photograph_as_told_has_no_findings(photograph, small_rig):
    assert look(photograph(), small_rig) == []
    assert look(photograph(exposure_s=1 / 64), small_rig) == []
    assert look(photograph(serial="00600"), small_rig) == []


@pytest.mark.parametrize(
    "wrong", [{"iso": 400}, {"exposure_s": 1 / 50}, {"exposure_s": 60.0}, {"f_number": 9.0}]
)
def test_a_setting_that_drifted_is_to_be_taken_again(photograph, small_rig, wrong):
    assert look(photograph(**wrong), small_rig) == [("retake", "drift")]


def test_another_cameras_photograph_is_refused(photograph, small_rig):
    assert look(photograph(serial="601"), small_rig) == [("refuse", "wrong-camera")]


def test_a_maker_that_writes_other_numbers_into_files_is_doubted_not_refused(photograph, small_rig):
    path = photograph(serial="59Y1", model="FUJIFILM X-T5")
    stated = dataclasses.replace(TOLD, serial="600")
    assert look(path, small_rig, stated) == [("warn", "wrong-camera")]
    # Where the body told nothing, the file alone says whose it is.
    assert look(path, small_rig) == [("refuse", "wrong-camera")]
    nikon = photograph(serial="601")
    assert look(nikon, small_rig, stated) == [("refuse", "wrong-camera")]


def test_what_the_camera_cannot_tell_is_not_compared(photograph, small_rig):
    assert look(photograph(iso=800, f_number=2.0), small_rig, Summary(shutter="1/60")) == []


def test_what_the_file_does_not_say_is_not_compared(tmp_path, small_rig, dng):
    (tmp_path / "plain.dng").write_bytes(dng(700))
    assert look(tmp_path / "plain.dng", small_rig) == []
    assert look(write_exr(tmp_path / "a.exr", np.ones((2, 2, 3))), small_rig) == []


def test_an_iso_above_sixteen_bits_is_no_drift(photograph, small_rig):
    high = dataclasses.replace(TOLD, iso="102400")
    assert look(photograph(iso=65535), small_rig, high) == []
    assert look(photograph(iso=51200), small_rig, high) == [("retake", "drift")]


def test_a_name_in_the_file_is_refused_and_not_repeated(photograph, small_rig):
    path = photograph(artist="Ann Person")
    assert look(path, small_rig) == [("refuse", "privacy")]
    (finding,) = photograph_findings(path, small_rig.cameras[0], TOLD)
    assert "Artist" in finding.found
    assert "Ann" not in str(finding)


def test_a_time_that_is_off_is_reported(photograph, small_rig):
    near = photograph(taken="2026:03:04 05:06:00")
    assert look(near, small_rig, exposed_utc=EXPOSED) == []
    far = photograph(taken="2026:03:04 05:11:00")
    assert look(far, small_rig, exposed_utc=EXPOSED) == [("warn", "clock")]
    assert look(far, small_rig) == []


def test_a_time_without_a_zone_may_be_a_zone_off_but_not_a_day(photograph, small_rig):
    zoneless = photograph(taken="2026:03:04 10:36:05", offset=None)
    assert look(zoneless, small_rig, exposed_utc=EXPOSED) == []
    later = photograph(taken="2026:03:04 10:40:05", offset=None)
    assert look(later, small_rig, exposed_utc=EXPOSED) == [("warn", "clock")]
    old = photograph(taken="2026:03:03 05:06:07", offset=None)
    assert look(old, small_rig, exposed_utc=EXPOSED) == [("warn", "clock")]


def test_a_photograph_that_is_gone_is_the_disks_fault(tmp_path, small_rig):
    with pytest.raises(CaptureError, match="gone"):
        look(tmp_path / "none.dng", small_rig)
