"""What an operator sees when cameras misbehave: each test is a story of `lightstage capture`."""

from __future__ import annotations

import os
import types

import numpy as np
import pytest

from lightstage.cameras.binding import close_cameras, find_cameras, read_cameras_file
from lightstage.capture import connect
from lightstage.checks import check_session
from lightstage.errors import DeviceError, FormatError
from lightstage.leds.controller import Hello
from lightstage.session import read_journal
from sim.devices import camera_body
from sim.devices.faults import Fault, FaultLog, Story, read_fault_log
from sim.devices.simulated_camera import SimulatedCamera, SimulatedCameras
from sim.errors import SimError

ALL_BUT_CAM1 = ["x+/cam0", "x+/cam2"]


def refused_at_x(stage, ending, *parts):
    """Told, dark, the others' photographs of the shot kept, and only `full` counts."""
    for part in (*parts, "pattern x+: 2 of 3 photographs kept"):
        assert part in ending.said, ending.said
    assert ending.dark
    assert ending.shots() == ["full"]
    assert ending.kept() == ["full/cam0", "full/cam1", "full/cam2", *ALL_BUT_CAM1]
    assert not (ending.root / "session.json").exists()
    events = read_journal(ending.root / "journal.jsonl")
    assert [e["camera"] for e in events if e["event"] == "failed"] == ["cam1"]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (Fault("fail", camera="cam1", at=2), "no picture was taken"),
        (Fault("disconnect", camera="cam1", at=2), "the camera is gone from the bus"),
        (Fault("battery-empty", camera="cam1", at=2), "switched itself off"),
        (Fault("fill-up", camera="cam1", at=2), "the card is full). Free its card"),
        (Fault("truncated", camera="cam1", at=2), "The file is truncated"),
        (Fault("late-file", camera="cam1", at=2), "no file came of this shot"),
        (Fault("stale", camera="cam1", at=2), "x+ by cam1: found the bytes of full by cam1"),
    ],
    ids=lambda value: value.name if isinstance(value, Fault) else "",
)
def test_a_camera_that_fails_in_its_second_shot_is_told_and_nothing_else_is_lost(
    stage, fault, said
):
    ending = stage.capture(fault)
    assert ending.happened == [fault.name]
    refused_at_x(stage, ending, said)


def test_a_camera_that_hangs_in_a_capture_is_ended_and_the_lights_go_out(stage):
    ending = stage.capture(Fault("hang", camera="cam1", at=2), camera_deadline_s=1.5)
    refused_at_x(stage, ending, "camera cam1, capture: found no answer within 1.5 s")


def test_a_card_with_room_for_two_files_is_full_at_the_third(stage):
    ending = stage.capture(settings={"cam2": {"card_files": 2}})
    assert "pattern x-: 2 of 3 photographs kept" in ending.said
    assert "the card is full" in ending.said
    assert ending.dark
    assert ending.happened == []


@pytest.mark.parametrize(
    "fault",
    [
        Fault("slow", camera="cam0", at=2, seconds=0.4),
        Fault("event-storm", camera="cam1", at=1, until=3),
        Fault("other-order", at=1, until=3),
    ],
    ids=lambda fault: fault.name,
)
@pytest.mark.parametrize("image_format", ["RAW", "RAW+JPEG"])
def test_what_comes_late_or_in_another_order_is_kept_under_its_own_name(stage, fault, image_format):
    settings = {camera.id: {"image_format": image_format} for camera in stage.rig.cameras}
    ending = stage.capture(fault, settings=settings)
    assert ending.said == ""
    assert set(ending.happened) == {fault.name}
    assert ending.fine
    assert stage.mislabelled(ending) == []


def test_a_camera_that_makes_jpegs_is_refused_at_its_first_shot(stage):
    ending = stage.capture(settings={"cam1": {"image_format": "JPEG"}})
    assert "found a JPEG" in ending.said
    assert "Set the camera's picture format to RAW" in ending.said
    assert ending.dark
    assert ending.kept() == ["full/cam0", "full/cam2"]


def test_two_cameras_of_one_serial_number_are_refused_before_a_light_goes_on(stage):
    ending = stage.capture(Fault("duplicate-serial", camera="cam1", value="600"))
    assert "camera cam1, serial: found 600, expected 601" in ending.said
    assert "cameras cam0, cam1, serial: found 600 for all of them" in ending.said
    assert not ending.root.exists()


def test_an_iso_that_drifts_between_shots_shows_when_the_session_is_checked(stage):
    ending = stage.capture(Fault("wrong-iso", camera="cam1", at=3, value="400"))
    assert ending.happened == ["wrong-iso"]
    with pytest.raises(FormatError, match=r"patterns of cam1: found x\+ \+ x- = "):
        check_session(ending.root)


def make_bodies(tmp_path, rig, seen, *faults, **settings):
    log = FaultLog(tmp_path / "faults.jsonl")
    bodies = SimulatedCameras(tmp_path / "bodies", rig, Story(faults), log, settings)
    for number, camera in enumerate(rig.cameras):
        bodies.put(camera.id, seen(np.ones(8), number))
    return bodies


@pytest.fixture
def processes(tmp_path, rig, seen):
    """Cameras as the product opens them: the cameras file, one process each."""
    opened = []

    def start(*faults, deadline_s=20.0):
        bodies = make_bodies(tmp_path, rig, seen, *faults)
        path = tmp_path / "cameras.toml"
        path.write_text(bodies.cameras_file())
        opened.extend(find_cameras(rig, read_cameras_file(path), deadline_s, lambda _: []))
        return opened

    yield start
    close_cameras(opened)


class DarkLights:
    hello = Hello(1, 8, "none")

    def dark(self):
        pass


def test_a_camera_that_hangs_is_ended_at_its_deadline_and_is_the_same_camera_afterwards(
    processes, tmp_path, rig, seen
):
    cameras = processes(Fault("hang", camera="cam1", at=2))
    assert [s.serial for s in connect(rig, DarkLights(), cameras, [])] == ["600", "601", "602"]
    assert cameras[1].capture(0.0).name == "DSC_0001.DNG"
    cameras[1].deadline_s = 0.5
    pid = cameras[1].pid
    with pytest.raises(DeviceError, match=r"camera cam1, capture: found no answer within 0\.5 s"):
        cameras[1].capture(0.0)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert cameras[0].capture(0.0).data == seen(np.ones(8), 0)
    cameras[1].deadline_s = 20.0
    cameras[1].open()
    taken = cameras[1].capture(0.0)
    # It counts on: the shot at which it hung has happened.
    assert taken.name == "DSC_0003.DNG"
    assert taken.data == seen(np.ones(8), 1)
    told = read_fault_log(tmp_path / "faults.jsonl")
    assert [(each.device, each.name, each.count) for each in told] == [("cam1", "hang", 2)]


def test_a_camera_that_was_disconnected_comes_back(tmp_path, rig, seen, monkeypatch):
    fault = Fault("disconnect", camera="cam0", at=1, seconds=20)
    bodies = make_bodies(tmp_path, rig, seen, fault)
    now_s = [100.0]
    clock = types.SimpleNamespace(monotonic=lambda: now_s[0], sleep=lambda _: None)
    monkeypatch.setattr(camera_body, "time", clock)
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    camera.open()
    with pytest.raises(DeviceError, match=r"error -7 .*gone from the bus"):
        camera.capture(0.0)
    now_s[0] += 19
    with pytest.raises(DeviceError, match=r"error -105 .*No such camera is connected"):
        camera.open()
    with pytest.raises(DeviceError, match="not open"):
        camera.capture(0.0)
    now_s[0] += 2
    camera.open()
    assert camera.capture(0.0).name == "DSC_0002.DNG"


def test_the_file_of_a_shot_that_came_too_late_is_not_taken_for_the_next(tmp_path, rig, seen):
    bodies = make_bodies(tmp_path, rig, seen, Fault("late-file", camera="cam0", at=1))
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    camera.open()
    with pytest.raises(DeviceError, match="no file came of this shot"):
        camera.capture(0.0)
    bodies.put("cam0", seen(np.zeros(8), 0))
    taken = camera.capture(0.0)
    assert taken.name == "DSC_0002.DNG"
    assert taken.data == seen(np.zeros(8), 0)


def test_of_a_pair_the_raw_is_taken_whatever_comes_first(tmp_path, rig, seen):
    faults = [Fault("other-order", camera="cam0", at=2)]
    bodies = make_bodies(tmp_path, rig, seen, *faults, cam0={"image_format": "RAW+JPEG"})
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    camera.open()
    for shot in (1, 2):
        taken = camera.capture(0.0)
        assert taken.name == f"DSC_000{shot}.DNG"
        assert taken.data == seen(np.ones(8), 0)
    assert camera.settings()["card_free"] == 1000 - 4


def test_every_setting_can_be_read_changed_and_drifts(tmp_path, rig, seen):
    drifts = [
        Fault("drift", camera="cam0", at=1),
        Fault("drift", camera="cam0", at=2, setting="focus_mode", value="AF-S"),
        Fault("drift", camera="cam0", at=3, setting="battery_percent", value="7"),
        Fault("drift", camera="cam0", at=4, setting="clock_offset_s", value="-3600"),
    ]
    bodies = make_bodies(tmp_path, rig, seen, *drifts)
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    camera.open()
    before = camera.settings()
    for _ in drifts:
        camera.capture(0.0)
    after = camera.settings()
    changed = {key: value for key, value in after.items() if value != before[key]}
    assert changed == {
        "white_balance": "Auto",
        "focus_mode": "AF-S",
        "battery_percent": 7,
        "clock_offset_s": -3600.0,
        "card_free": 996,
    }
    camera.change("white_balance", "Daylight")
    assert camera.settings()["white_balance"] == "Daylight"
    with pytest.raises(SimError, match="zoom: found unknown, expected one of serial, model, iso"):
        camera.change("zoom", "3")
    with pytest.raises(SimError, match="battery_percent: found 'low', expected int"):
        camera.change("battery_percent", "low")


def test_a_stop_more_light_doubles_the_counts_above_black(tmp_path, rig, seen):
    bodies = make_bodies(tmp_path, rig, seen, Fault("wrong-iso", camera="cam0", at=1, value="200"))
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    assert camera.open().iso == "100"
    taken = _counts(camera.capture(0.0).data)
    known = _counts(seen(np.ones(8), 0))
    np.testing.assert_array_equal(taken, 512 + 2 * (known - 512))
    assert camera.open().iso == "200"
    camera.change("aperture", "f/16")
    np.testing.assert_allclose(
        _counts(camera.capture(0.0).data), 512 + 0.5 * (known - 512), atol=0.5
    )


def test_the_same_fault_may_hit_every_camera_or_one(tmp_path, rig, seen):
    bodies = make_bodies(tmp_path, rig, seen, Fault("fail", at=1))
    for camera in rig.cameras:
        driver = SimulatedCamera(str(bodies.folder(camera.id)))
        driver.open()
        with pytest.raises(DeviceError, match="error -1"):
            driver.capture(0.0)
    with pytest.raises(SimError, match=r"fault|story, fail, camera: found 'cam9'"):
        SimulatedCameras(tmp_path / "x", rig, Story([Fault("fail", camera="cam9")]))


def _counts(data):
    import io

    import tifffile

    return tifffile.imread(io.BytesIO(data)).astype(float)
