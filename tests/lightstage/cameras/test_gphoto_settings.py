"""Settings under their makers' names."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.cameras import file_names
from lightstage.cameras import gphoto_settings as known
from lightstage.cameras.gphoto import GphotoCamera
from lightstage.errors import DeviceError

PORT = "usb:001,004"


def opened():
    camera = GphotoCamera(PORT)
    return camera, camera.open()


def test_a_nikon_reports_all_but_its_place(fake):
    fake.make_body("6001", settings={"datetime": int(time.time()) - 3600, "ownername": "Me"})
    _, summary = opened()
    assert summary.not_readable() == ["place"]
    assert (summary.serial, summary.model, summary.firmware) == ("6001", "Nikon DSC D750", "V1.12")
    assert (summary.mode, summary.iso, summary.shutter, summary.aperture) == (
        "M",
        "100",
        "1/60",
        "f/8",
    )
    assert (summary.image_format, summary.focus) == ("NEF (Raw)", "Manual")
    assert (summary.battery_percent, summary.card_free_bytes) == (75.0, 2_048_000_000)
    assert (summary.owner, summary.artist, summary.copyright) == ("Me", "", "")
    assert summary.clock_offset_s == pytest.approx(-3600, abs=10)


def test_a_canon_reports_the_same_under_its_own_names(fake):
    canon = {
        "eosserialnumber": "022021001234",
        "autoexposuremode": "Manual",
        "aperture": "8",
        "shutterspeed": "1/60",
        "imageformat": "RAW + Large Fine JPEG",
        "ownername": "",
    }
    settings = dict.fromkeys(("expprogram", "shutterspeed2", "f-number", "imagequality"), "")
    fake.make_body("6001", settings=settings | canon)
    _, summary = opened()
    assert summary.serial == "022021001234"
    assert (summary.mode, summary.aperture, summary.shutter) == ("Manual", "8", "1/60")
    assert summary.image_format == "RAW + Large Fine JPEG"
    assert summary.owner == ""


def test_an_iso_that_the_camera_chooses_itself_does_not_look_like_the_one_that_is_set(fake):
    fake.make_body("6001", settings={"isoauto": "On"})
    assert opened()[1].iso == "auto, from 100"


def test_a_setting_is_changed_and_read_back(fake):
    camera, _ = opened()
    camera.change("iso", "400")
    camera.change("artist", "nobody")
    assert (camera.summary().iso, camera.summary().artist) == ("400", "nobody")
    with pytest.raises(DeviceError, match="iso: found '401', expected of 100, 200, 400"):
        camera.change("iso", "401")
    with pytest.raises(DeviceError, match="place: found a camera that has no such setting"):
        camera.change("place", "off")


def test_a_camera_that_does_not_keep_a_change_is_reported(fake):
    fake.make_body("6001", keeps=False)
    camera, _ = opened()
    with pytest.raises(DeviceError, match=r"iso: found 100, expected 400.*set it on the camera"):
        camera.change("iso", "400")


def test_the_clock_is_set_by_its_offset(fake):
    fake.make_body("6001", settings={"datetime": 1000})
    camera, _ = opened()
    camera.change("clock_offset_s", "0")
    assert camera.summary().clock_offset_s == pytest.approx(0, abs=5)


def test_pairs_are_recognised_by_the_maker_s_word_for_them():
    for text in ("NEF+Fine", "RAW + Large Fine JPEG", "RAW+JPEG"):
        assert known.files_of_a_shot(text) == 2
    for text in ("NEF (Raw)", "RAW", "JPEG Fine", None):
        assert known.files_of_a_shot(text) == 1


@given(st.text(max_size=12) | st.floats().map(str) | st.floats().map(lambda x: f"{x}%"))
def test_a_charge_is_a_percentage_or_unknown(text):
    value = known.percent(text)
    assert value is None or (math.isfinite(value) and 0 <= value <= 100)


@given(st.text(max_size=20))
def test_whatever_is_not_known_to_be_something_else_is_a_photograph(name):
    known_suffix = file_names.suffix(name) in file_names.NO_PHOTOGRAPHS
    assert file_names.is_photograph(name) != known_suffix
    assert file_names.is_photograph(name + ".NEF")
    assert file_names.is_photograph("MOV")
    assert not file_names.is_photograph("A.MOV")
