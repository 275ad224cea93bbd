"""Simulated cameras at the cameras' Protocol: what faults do, in processes of their own."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
import tifffile

from lightstage.cameras.binding import close_cameras
from lightstage.cameras.camera import VERIFIABLE
from lightstage.cameras.process import CameraProcess, Deadlines
from lightstage.errors import DeviceError
from sim.devices import simulated_camera
from sim.devices.body_folder import NEXT, put, write_body
from sim.devices.camera_settings import CameraSettings
from sim.devices.faults import Fault, FaultLog, Story, read_fault_log
from sim.devices.simulated_camera import DRIVER, SimulatedCamera


def dng() -> bytes:
    """A small DNG as sim.camera.exposure wants it."""
    tags = [
        (50706, 1, 4, b"\x01\x04\x00\x00", True),
        (50714, 3, 1, 512, True),
        (50717, 3, 1, 16383, True),
    ]
    counts = np.arange(32 * 48, dtype=np.uint16).reshape(48, 32)
    file = io.BytesIO()
    tifffile.imwrite(file, counts, photometric=32803, extratags=tags, metadata=None)
    return file.getvalue()


def test_a_cameras_process_starts_without_what_only_pictures_need():
    """Each camera of each capture starts one."""
    module = DRIVER.partition(":")[0]
    script = f"import sys, {module}; print(sorted({{'cv2', 'numba', 'scipy'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "[]\n"), done.stderr


@pytest.fixture
def body(tmp_path):
    """Makes a body with a story; its log lies beside it."""

    def make(*faults, name="cam0", serial="600", **settings):
        log = FaultLog(tmp_path / "log")
        own = CameraSettings(serial, "Simulated", **settings)
        folder = write_body(tmp_path / "bus" / name, name, own, Story(faults), log)
        put(folder / NEXT, dng())
        return folder

    return make


@pytest.fixture
def camera(body):
    """Makes an opened camera process on a new body."""
    made = []

    def make(*faults, **more):
        folder = body(*faults, **more)
        made.append(CameraProcess(folder.name, str(folder), None, 20.0, DRIVER))
        made[-1].open()
        return made[-1]

    yield make
    close_cameras(made)


def files(exposure):
    return [file.name for file in exposure.files]


def happened(tmp_path):
    return [(happenings.name, happenings.count) for happenings in read_fault_log(tmp_path / "log")]


def test_it_reports_everything_that_a_camera_can_be_asked(camera):
    summary = camera(firmware="2.10", owner="A", place="N 48", card_bytes=10**9).summary()
    assert summary.not_readable() == []
    assert (summary.firmware, summary.owner, summary.place) == ("2.10", "A", "N 48")
    assert summary.card_free_bytes == 10**9


def test_every_setting_is_changed_by_its_own_name_and_outlives_its_process(camera):
    one = camera()
    wanted = {
        "iso": "200", "shutter": "1/30", "aperture": "f/4", "white_balance": "Flash",
        "image_format": "RAW+JPEG", "mode": "M", "focus": "MF", "battery_percent": "50",
        "clock_offset_s": "2.5", "firmware": "3", "owner": "O", "artist": "A", "copyright": "C",
        "place": "on", "model": "Other",
    }  # fmt: skip
    for name, value in wanted.items():
        one.change(name, value)
    summary = one.restart()
    assert {name: str(getattr(summary, name)) for name in wanted} == wanted
    assert set(VERIFIABLE) - set(wanted) == {"serial", "card_free_bytes"}


def test_the_card_outlives_its_process_and_files_go_when_they_are_deleted(camera, tmp_path):
    one = camera(image_format="RAW+JPEG")
    first = one.trigger(0.0)
    assert files(first) == ["/DCIM/100SIM/DSC_0001.DNG", "/DCIM/100SIM/DSC_0001.JPG"]
    one.restart()
    assert one.card() == first.files
    one.delete(first.files[0].name)
    assert one.card() == first.files[1:]
    with pytest.raises(DeviceError, match="error -108"):
        one.download(first.files[0].name, tmp_path / "x")


def test_a_card_is_full_by_its_files_its_bytes_or_the_story(camera):
    assert camera(card_files=0).summary().card_free_bytes == 0
    size = len(dng())
    by_bytes = camera(name="cam1", serial="601", card_bytes=size)
    by_bytes.trigger(0.0)
    assert by_bytes.summary().card_free_bytes == 0
    with pytest.raises(DeviceError, match=r"error -3 .*the card is full"):
        by_bytes.trigger(0.0)
    story = camera(Fault("fill-up", at=2, until=2), name="cam2", serial="602")
    story.trigger(0.0)
    assert story.summary().card_free_bytes == 0


def test_a_busy_camera_triggers_once_when_it_is_ready(camera, tmp_path):
    one = camera(Fault("busy", at=1, seconds=0.3))
    exposure = one.trigger(0.0)
    assert exposure.exposed_s - exposure.triggered_s >= 0.3
    assert files(exposure) == ["/DCIM/100SIM/DSC_0001.DNG"]
    assert happened(tmp_path) == [("busy", 1)]


def test_a_camera_that_another_program_has_is_waited_for(body, tmp_path, monkeypatch):
    driver = SimulatedCamera(str(body(Fault("claimed", at=1, seconds=0.3))))
    assert driver.open().serial == "600"
    assert happened(tmp_path) == [("claimed", 1)]
    monkeypatch.setattr(simulated_camera, "PATIENCE_S", 0.2)
    lasting = Fault("claimed", at=1, seconds=3600)
    with pytest.raises(DeviceError, match=r"error -53 .*Another program has the camera"):
        SimulatedCamera(str(body(lasting, name="cam1"))).open()


def test_a_picture_whose_trigger_was_cut_off_lies_on_the_card_after_a_restart(camera, tmp_path):
    one = camera(Fault("io", at=2))
    one.trigger(0.0)
    known = set(one.card())
    with pytest.raises(DeviceError, match=r"trigger: found error -7"):
        one.trigger(0.0)
    one.restart()
    assert [f.name for f in one.card() if f not in known] == ["/DCIM/100SIM/DSC_0002.DNG"]
    assert happened(tmp_path) == [("io", 2)]


def test_a_download_that_is_cut_off_is_begun_again(camera, tmp_path):
    one = camera(Fault("io", at=1, during="download"))
    (file,) = one.trigger(0.0).files
    got = one.download(file.name, tmp_path / "x")
    assert got.size == file.size
    assert (tmp_path / "x").read_bytes() == dng()


def test_a_file_that_comes_short_is_reported_whole_by_the_card_and_is_whole_when_asked_again(
    camera, tmp_path
):
    one = camera(Fault("truncated", at=1, share=0.25))
    (file,) = one.trigger(0.0).files
    assert file.size == len(dng())
    assert one.card() == (file,)
    assert one.download(file.name, tmp_path / "short").size == round(file.size * 0.25)
    assert one.download(file.name, tmp_path / "whole").size == file.size


@pytest.mark.parametrize("during", ["trigger", "download"])
def test_a_camera_hangs_where_the_story_says_and_has_its_picture(camera, tmp_path, during):
    one = camera(Fault("hang", at=1, during=during))
    one.deadlines = Deadlines(trigger_s=0.4, download_s=0.4)

    def shot():
        (file,) = one.trigger(0.0).files
        one.download(file.name, tmp_path / "x")

    with pytest.raises(DeviceError, match=f"camera cam0, {during}: found no answer within 0.4"):
        shot()
    one.restart()
    (file,) = one.card()
    assert one.download(file.name, tmp_path / "after").size == len(dng())


def test_a_camera_at_another_port_is_found_by_its_serial_number_among_others(camera, tmp_path):
    one, other = camera(Fault("port-changes", at=1)), camera(name="cam1", serial="601")
    with pytest.raises(DeviceError, match="gone from this port"):
        one.trigger(0.0)
    assert one.restart().serial == "600"
    assert one.port == str(tmp_path / "bus" / "cam0-port1")
    assert files(one.trigger(0.0)) == ["/DCIM/100SIM/DSC_0002.DNG"]
    assert other.trigger(0.0).files
    assert SimulatedCamera.ports(other.port) == [
        ("Simulated", one.port), ("Simulated", other.port),
    ]  # fmt: skip
    with pytest.raises(DeviceError, match="error -105"):
        SimulatedCamera(str(tmp_path / "bus" / "cam0")).open()


def test_a_camera_that_is_gone_for_a_while_is_waited_for(camera):
    one = camera(Fault("disconnect", at=1, seconds=0.8))
    with pytest.raises(DeviceError, match="unplugged"):
        one.trigger(0.0)
    assert one.restart().serial == "600"
    assert files(one.trigger(0.0)) == ["/DCIM/100SIM/DSC_0002.DNG"]


def test_a_camera_whose_battery_is_empty_is_given_up_after_a_while(camera):
    one = camera(Fault("battery-empty", at=1))
    with pytest.raises(DeviceError, match="battery is empty"):
        one.trigger(0.0)
    one.deadlines = Deadlines(absent_s=0.3)
    with pytest.raises(DeviceError, match=r"camera cam0, restart: .*with serial 600"):
        one.restart()


def test_somebodys_name_appears_in_the_owner_field(camera):
    one = camera(Fault("owner-set", at=1, value="B. Person"))
    assert one.summary().owner == ""
    one.trigger(0.0)
    assert one.summary().owner == "B. Person"
    one.change("owner", "")
    assert one.summary().owner == ""


def test_a_clock_drifts(camera):
    one = camera(Fault("drift", at=1, setting="clock_offset_s", value="90"))
    one.trigger(0.0)
    assert one.summary().clock_offset_s == 90.0


def test_what_no_setting_can_be_is_refused_with_the_port(body):
    driver = SimulatedCamera(str(body()))
    driver.open()
    with pytest.raises(DeviceError, match="cam0, image_format: found 'TIFF', expected one of RAW"):
        driver.change("image_format", "TIFF")
