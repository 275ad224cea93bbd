"""The libgphoto2 driver against a library that misbehaves as real cameras do."""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import time

import pytest

from lightstage.cameras.gphoto import GphotoCamera
from lightstage.cameras.gphoto_link import Patience
from lightstage.errors import DeviceError

PORT = "usb:001,004"
STEADY = Patience(claimed_tries=4, claimed_pause_s=0.01, busy_s=0.6, event_s=20.0, quiet_s=0.5)
BRIEF = dataclasses.replace(STEADY, event_s=0.8)
"""For shots that give no file: so long they are waited for."""


def opened(patience=STEADY, port=PORT):
    camera = GphotoCamera(port, patience=patience)
    camera.open()
    return camera


def names(exposure):
    return [file.name.rpartition("/")[2] for file in exposure.files]


def test_the_fake_library_frees_memory_as_the_real_one_does(fake):
    """The trap itself: what is copied from a CameraFile that nobody holds is not the picture."""
    file = fake.CameraFile(b"picture" * 100)
    data = file.get_data_and_size()
    del file
    gc.collect()
    assert bytes(data) == bytes([fake.POISON]) * 700


def test_a_download_is_what_lies_on_the_card_though_memory_goes_with_its_owner(fake, tmp_path):
    camera = opened()
    for number in range(1, 6):
        (file,) = camera.trigger(0.0).files
        got = camera.download(file.name, tmp_path / f"{number}")
        known = fake.picture("6001", f"DSC_{number:04d}.NEF")
        assert (tmp_path / f"{number}").read_bytes() == known
        assert got.sha256 == hashlib.sha256(known).hexdigest()
        assert got.size == file.size == len(known)


def test_a_cut_download_is_reported_and_leaves_no_file(fake, tmp_path):
    fake.make_body("6001", cut=1000)
    camera = opened()
    (file,) = camera.trigger(0.0).files
    with pytest.raises(DeviceError, match="found 1000 bytes, expected 65536 bytes"):
        camera.download(file.name, tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_raw_and_jpeg_of_one_shot_come_together_raw_first(fake):
    fake.make_body(
        "6001",
        settings={"imagequality": "NEF+Fine"},
        shots=[["jpeg", "done", 0.05, "raw"], ["raw", "jpeg"], ["done", "jpeg", "raw"]],
    )
    camera = opened()
    for number in (1, 2, 3):
        assert names(camera.trigger(0.0)) == [f"DSC_{number:04d}.NEF", f"DSC_{number:04d}.JPG"]


def test_a_pair_of_which_one_file_never_comes_is_reported_by_what_came(fake):
    fake.make_body("6001", settings={"imagequality": "NEF+Fine"}, shots=[["raw", "done"]])
    assert names(opened().trigger(0.0)) == ["DSC_0001.NEF"]


def test_events_that_are_late_or_of_no_meaning_are_waited_for(fake):
    fake.make_body("6001", shots=[[0.3, *["other"] * 50, 0.05, "raw", 0.02, "done"]])
    exposure = opened().trigger(0.0)
    assert names(exposure) == ["DSC_0001.NEF"]
    assert exposure.exposed_s - exposure.triggered_s >= 0.35


def test_a_file_of_an_earlier_shot_is_never_taken_for_this_one(fake):
    """The first shot gives no file; it comes after the second trigger, before the second's own."""
    second = ["late DSC_0001.NEF", "done", 0.1, "raw"]
    fake.make_body("6001", shots=[["done"], second, ["raw", "done"]])
    camera = opened(BRIEF)
    with pytest.raises(DeviceError, match=r"found no file.*Is its card full"):
        camera.trigger(0.0)
    with pytest.raises(DeviceError, match=r"files of 2 shots .*still on the card"):
        camera.trigger(0.0)
    assert names(camera.trigger(0.0)) == ["DSC_0003.NEF"]
    assert len(camera.card()) == 3


def test_a_file_that_is_reported_twice_counts_for_its_own_shot_only(fake):
    fake.make_body("6001", shots=[["raw", "done"], ["late DSC_0001.NEF", "raw", "done"]])
    camera = opened()
    assert names(camera.trigger(0.0)) == ["DSC_0001.NEF"]
    assert names(camera.trigger(0.0)) == ["DSC_0002.NEF"]


def test_what_comes_after_a_shot_was_done_is_emptied_before_the_next(fake, tmp_path):
    fake.make_body("6001", shots=[["raw", "done", "jpeg"], ["raw", "done"]])
    camera = opened()
    (file,) = camera.trigger(0.0).files
    camera.download(file.name, tmp_path / "x")
    assert names(camera.trigger(0.0)) == ["DSC_0002.NEF"]


def test_no_long_wait_is_asked_for_since_each_may_outlast_its_time(fake):
    """Asked for all of its time at once, a wait that takes longer would end at no known moment."""
    fake.make_body("6001", shots=[[]], overrun_s=0.15)
    with pytest.raises(DeviceError, match="found no file"):
        opened(BRIEF).trigger(0.0)
    assert 1 <= fake.body_of("6001")["longest_wait_ms"] <= 250


def test_a_late_file_that_comes_alone_is_not_the_shot_s_that_failed_too(fake, tmp_path):
    """It reached the card after the first trigger's deadline and before the second trigger."""
    fake.make_body("6001", shots=[["done"], ["late DSC_0001.NEF", "done"]])
    camera = opened(BRIEF)
    with pytest.raises(DeviceError, match="found no file"):
        camera.trigger(0.0)
    (tmp_path / "bus" / "6001" / "card" / fake.FOLDER[1:] / "DSC_0001.NEF").write_bytes(b"late")
    with pytest.raises(DeviceError, match="found no file"):
        camera.trigger(0.0)


def test_a_claimed_camera_is_tried_again_and_then_told_by_whom(fake):
    fake.make_body("6001", answers={"init": [-53, -53, -53]})
    assert opened().summary().serial == "6001"
    fake.make_body("6001", answers={"init": [-53] * 4})
    with pytest.raises(DeviceError, match=r"error -53 .*gvfs-gphoto2-volume-monitor.*PTPCamera"):
        opened()


def test_a_busy_camera_is_asked_again_and_triggers_once(fake):
    fake.make_body("6001", answers={"trigger_capture": [-110, -110]})
    exposure = opened().trigger(0.0)
    assert names(exposure) == ["DSC_0001.NEF"]
    body = fake.body_of("6001")
    assert body["taken"] == 1
    assert body["calls"].count("trigger_capture") == 3


def test_a_camera_that_stays_busy_is_reported(fake):
    fake.make_body("6001", answers={"file_get_info": [-110] * 99})
    with pytest.raises(DeviceError, match=r"error -110 .*The camera is busy"):
        opened().trigger(0.0)


def test_an_io_problem_is_mended_by_exit_and_init_where_asking_twice_does_no_harm(fake, tmp_path):
    fake.make_body("6001", answers={"file_get": [-7], "get_storageinfo": [0, -7]})
    camera = opened()
    (file,) = camera.trigger(0.0).files
    camera.download(file.name, tmp_path / "x")
    assert (tmp_path / "x").read_bytes() == fake.picture("6001", "DSC_0001.NEF")
    assert camera.summary().card_free_bytes == 2_048_000_000
    calls = fake.body_of("6001")["calls"]
    assert (calls.count("init"), calls.count("exit")) == (3, 2)


def test_a_body_that_was_cut_off_before_is_greeted_twice(fake):
    fake.make_body("6001", answers={"init": [-7], "get_single_config": [-7]})
    assert opened().summary().serial == "6001"
    assert fake.body_of("6001")["calls"].count("init") == 3


def test_an_io_problem_that_stays_is_reported(fake, tmp_path):
    fake.make_body("6001", answers={"file_get": [-7, -7]})
    camera = opened()
    (file,) = camera.trigger(0.0).files
    with pytest.raises(DeviceError, match=r"download: .*error -7 .*plug its cable in again"):
        camera.download(file.name, tmp_path / "x")


def test_a_trigger_is_never_repeated_after_an_io_problem(fake):
    """Nobody knows whether it was heard: a second picture would have no light of its own."""
    fake.make_body("6001", answers={"trigger_capture": [-7]})
    with pytest.raises(DeviceError, match=r"trigger: .*error -7"):
        opened().trigger(0.0)
    assert fake.body_of("6001")["calls"].count("trigger_capture") == 1


def test_another_body_that_answers_after_an_io_problem_is_refused(fake):
    fake.make_body("6001", answers={"folder_list_files": [-7]})
    fake.make_body("6002")
    camera = opened()
    fake.plug({PORT: "6002"})
    with pytest.raises(DeviceError, match="found 6002, expected 6001, which was here before"):
        camera.card()
    with pytest.raises(DeviceError, match="not open"):
        camera.trigger(0.0)


def test_a_camera_that_cannot_be_triggered_alone_captures(fake):
    fake.make_body("6001", can_trigger=False, settings={"imagequality": "NEF+Fine"})
    assert names(opened().trigger(0.0)) == ["DSC_0001.NEF", "DSC_0001.JPG"]
    assert "trigger_capture" not in fake.body_of("6001")["calls"]


def test_a_trigger_waits_for_its_moment(fake):
    camera = opened()
    at_s = time.monotonic() + 0.2
    assert camera.trigger(at_s).triggered_s >= at_s


def test_the_card_is_listed_in_all_its_folders_oldest_first_photographs_alone(fake, tmp_path):
    import os

    card = tmp_path / "bus" / "6001" / "card"
    wanted = ["store_00010001/DCIM/101ND750/DSC_0001.NEF", "store_00020001/DCIM/A/DSC_9999.XYZ"]
    for age, name in enumerate([*wanted, "store_00010001/DCIM/MOV_1.MOV", "store_00010001/X.DAT"]):
        path = card / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x" * (10 + age))
        os.utime(path, (1000 - age, 1000 - age))
    camera = opened()
    assert [(f.name, f.size) for f in camera.card()] == [
        ("/store_00020001/DCIM/A/DSC_9999.XYZ", 11),
        ("/store_00010001/DCIM/101ND750/DSC_0001.NEF", 10),
    ]
    camera.delete(camera.card()[0].name)
    assert [f.size for f in camera.card()] == [10]


def test_photographs_go_to_the_card_not_to_the_cameras_memory(fake):
    opened()
    assert fake.body_of("6001")["settings"]["capturetarget"] == "Memory card"
