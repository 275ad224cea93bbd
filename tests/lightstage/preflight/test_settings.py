"""What cameras must be set to before a light goes on."""

import dataclasses

import pytest

from lightstage.cameras.binding import CameraEntry, CamerasFile
from lightstage.cameras.camera import VERIFIABLE, Summary
from lightstage.preflight.config import PreflightConfig
from lightstage.preflight.settings import settings_findings

GOOD = Summary(
    serial="600",
    model="Nikon DSC D750",
    firmware="1.15",
    mode="M",
    iso="100",
    shutter="1/60",
    aperture="f/8",
    white_balance="Daylight",
    image_format="NEF (Raw)",
    focus="MF (fixed)",
    battery_percent=80.0,
    card_free_bytes=10**10,
    clock_offset_s=0.5,
    owner="",
    artist="",
    copyright="",
    place="off",
)


def look(file=None, cameras=3, **changes):
    """Findings where cam1 differs from the others as said."""
    values = {f"cam{i}": GOOD for i in range(cameras)}
    values["cam1"] = dataclasses.replace(GOOD, **changes)
    return settings_findings(values, file or CamerasFile(), PreflightConfig())


def test_cameras_alike_and_by_hand_are_ready():
    assert look() == []


def test_other_spellings_of_the_same_are_ready():
    spelt = {"mode": "Manual", "shutter": "0.0166s", "aperture": "8", "iso": "ISO 100"}
    assert look(**spelt, white_balance="Sunny", image_format="RAW", focus="Manual") == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": "A"}, "mode"),
        ({"focus": "AF-S"}, "focus"),
        ({"white_balance": "Auto"}, "white_balance"),
        ({"image_format": "JPEG Fine"}, "image_format"),
        ({"image_format": "mRAW"}, "of full size"),
        ({"image_format": "Unknown value 0008"}, "image_format"),
        ({"iso": "Auto"}, "iso"),
        ({"iso": "400"}, "400 (cam1)"),
        ({"shutter": "1/50"}, "1/50 (cam1)"),
        ({"shutter": "Bulb"}, "shutter"),
        ({"aperture": "f/11"}, "f/11 (cam1)"),
        ({"white_balance": "Cloudy"}, "Cloudy (cam1)"),
        ({"battery_percent": 19.0}, "19 %"),
        ({"battery_percent": float("nan")}, "battery"),
        ({"clock_offset_s": 3600.0}, "3600 s ahead"),
        ({"clock_offset_s": -61.0}, "61 s behind"),
        ({"clock_offset_s": float("nan")}, "clock"),
    ],
)
def test_each_wrong_setting_is_refused(change, message):
    found = [f for f in look(**change) if f.severity == "refuse"]
    assert found
    assert any(message in str(f) for f in found)
    assert all("cam1" in str(f) for f in found)


def test_a_picture_beside_the_raw_is_a_warning():
    (finding,) = look(image_format="NEF+Fine")
    assert (finding.severity, finding.camera) == ("warn", "cam1")


@pytest.mark.parametrize("name", [n for n in VERIFIABLE if n not in ("serial", "model")])
def test_what_a_camera_cannot_tell_must_be_allowed_by_name(name):
    (finding,) = look(**{name: None})
    assert (finding.severity, finding.code) == ("refuse", "untold")
    assert name in finding.where
    assert look(CamerasFile(allow_unverifiable=(name,)), **{name: None}) == []


def test_all_faults_of_all_cameras_come_at_once():
    values = {
        "cam0": dataclasses.replace(GOOD, mode="P", battery_percent=3.0),
        "cam1": dataclasses.replace(GOOD, iso="200", focus="AF-C"),
        "cam2": dataclasses.replace(GOOD, image_format="JPEG Basic", firmware=None),
    }
    found = settings_findings(values, CamerasFile(), PreflightConfig())
    codes = [(f.camera, f.code) for f in found]
    assert codes == [
        ("cam0", "mode"),
        ("cam0", "battery"),
        ("cam1", "focus"),
        ("cam2", "untold"),
        ("cam2", "image_format"),
        (None, "unlike"),
    ]
    assert all(f.hint for f in found)


def test_what_the_file_expects_of_all_is_compared_by_meaning():
    file = CamerasFile(expect={"iso": "100", "shutter": "0.0167", "image_format": "RAW"})
    assert look(file) == []
    found = look(CamerasFile(expect={"iso": "200"}))
    assert [f.camera for f in found] == ["cam0", "cam1", "cam2"]


def test_a_camera_of_its_own_may_differ_where_the_file_reports_it():
    own = CamerasFile(cameras={"cam1": CameraEntry(expect={"aperture": "f/11"})})
    assert look(own, aperture="11") == []
    (finding,) = look(own, aperture="f/16")
    assert "f/11 (the cameras file)" in finding.expected


def test_a_raw_with_a_jpeg_is_let_pass_where_raw_is_expected():
    found = look(CamerasFile(expect={"image_format": "RAW"}), image_format="RAW+JPEG")
    assert [f.severity for f in found] == ["warn"]


def test_an_expectation_that_nobody_can_check_is_refused():
    (finding,) = look(CamerasFile(cameras={"cam1": CameraEntry(expect={"colour": "red"})}))
    assert finding.severity == "refuse"
    assert "[cameras.cam1.expect]" in finding.where
