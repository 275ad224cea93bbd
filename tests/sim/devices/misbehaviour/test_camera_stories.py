"""What an operator sees when cameras misbehave: each test is a story of `lightstage capture`."""

from __future__ import annotations

import dataclasses
import os
import time
import types

import numpy as np
import pytest

from lightstage.cameras.binding import (
    close_cameras,
    find_cameras,
    read_cameras_file,
    try_cameras,
)
from lightstage.cameras.process import Deadlines
from lightstage.errors import DeviceError
from sim.devices import camera_body
from sim.devices.faults import Fault, FaultLog, Story, read_fault_log
from sim.devices.simulated_camera import SimulatedCamera, SimulatedCameras
from sim.errors import SimError

PLAIN = [f"{pattern}/cam{i}" for pattern in ("full", "x+", "x-") for i in range(3)]


@pytest.mark.parametrize(
    "fault",
    [
        Fault("fail", camera="cam1", at=2),
        Fault("disconnect", camera="cam1", at=2, seconds=0.5),
        Fault("stale", camera="cam1", at=2),
    ],
    ids=lambda fault: fault.name,
)
def test_only_the_camera_that_failed_takes_the_pattern_again(stage, fault):
    ending = stage.capture(fault)
    assert ending.happened == [fault.name]
    assert ending.fine, ending.message
    assert ending.report.retakes == 1
    assert ending.kept() == sorted([*(set(PLAIN) - {"x+/cam1"}), "x+/cam1.take2"])


@pytest.mark.parametrize("name", ["truncated", "late-file"])
def test_a_picture_that_is_on_the_card_is_fetched_and_not_taken_again(stage, name):
    ending = stage.capture(Fault(name, camera="cam1", at=2))
    assert ending.happened == [name]
    assert ending.fine, ending.message
    assert ending.report.retakes == 0
    assert ending.kept() == PLAIN


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault("battery-empty", camera="cam1", at=2), "its battery is empty"),
        (
            Fault("fill-up", camera="cam1", at=2),
            "the card is full. Copy its photographs away and format it",
        ),
    ],
    ids=lambda value: value.name if isinstance(value, Fault) else "",
)
def test_a_camera_that_cannot_go_on_is_reported_with_what_to_do_and_nothing_else_is_lost(
    stage, fault, message
):
    ending = stage.capture(fault)
    assert set(ending.happened) == {fault.name}
    for part in ("x+ by cam1", message, "To resume: lightstage capture --resume --out"):
        assert part in ending.message
    assert ending.dark
    assert ending.shots() == ["full"]
    assert ending.kept() == ["full/cam0", "full/cam1", "full/cam2", "x+/cam0", "x+/cam2"]
    assert not (ending.root / "session.json").exists()
    assert ending.lines("aborted")


def test_a_camera_that_hangs_is_ended_and_takes_its_picture_after_all(stage):
    deadlines = Deadlines(open_s=10.0, trigger_s=1.5, other_s=5.0)
    ending = stage.capture(Fault("hang", camera="cam1", at=2), deadlines=deadlines)
    assert ending.happened == ["hang"]
    assert ending.fine, ending.message
    # It hung with the picture on its card: found there, not taken again.
    assert ending.kept() == PLAIN
    assert any("no answer within 1.5 s" in line["said"] for line in ending.lines("note"))


def test_a_camera_that_hangs_does_not_keep_the_person_lit_and_takes_its_pattern_again_alone(stage):
    deadlines = Deadlines(open_s=10.0, trigger_s=4.0, other_s=5.0)
    stage.config = dataclasses.replace(stage.config, late_camera_grace_s=0.5, deadlines=deadlines)
    ending = stage.capture(Fault("hang", camera="cam1", at=2), deadlines=deadlines)
    assert ending.fine, ending.message
    # On a busy machine cameras that do not hang are waited for as well, at other patterns.
    warned, dark = [line for line in ending.lines("waiting") if line["pattern"] == "x+"][:2]
    assert (warned["cameras"], warned["lit"]) == (["cam1"], True)
    assert 0 < warned["dark_in_s"] <= 0.5
    assert warned["dark_in_s"] < dark["ended_in_s"] < warned["ended_in_s"] < 4.0
    assert dark["lit"] is False
    # The lights went out before the camera was ended, and of what shone then the device tells.
    (ended,) = [line for line in ending.lines("note") if "no answer within 4 s" in line["said"]]
    assert dark["id"] < ended["id"]
    full, x_plus = ending.shone[1:3]
    assert full.counts.all()
    assert x_plus.counts.any()
    assert not ending.shone[3].counts.any()
    # Whether its picture saw the light, nobody knows; the others' count.
    assert ending.recovered() == ["cam1/DCIM_100SIM_DSC_0002.DNG"]
    triggers = [line["takes"] for line in ending.lines("trigger") if line["pattern"] == "x+"]
    assert [sorted(takes) for takes in triggers] == [["cam0", "cam1", "cam2"], ["cam1"]]


def test_cameras_that_all_hang_on_the_first_shot_keep_nobody_lit(stage):
    deadlines = Deadlines(open_s=10.0, trigger_s=3.0, other_s=5.0)
    stage.config = dataclasses.replace(stage.config, late_camera_grace_s=0.5, deadlines=deadlines)
    faults = [Fault("hang", camera=camera.id, at=1) for camera in stage.rig.cameras]
    ending = stage.capture(*faults, deadlines=deadlines)
    assert ending.fine, ending.message
    ids = [camera.id for camera in stage.rig.cameras]
    warned, dark = ending.lines("waiting")[:2]
    assert (warned["pattern"], warned["cameras"], warned["lit"]) == ("full", ids, True)
    assert dark["lit"] is False
    assert 0 < warned["dark_in_s"] <= 0.5
    # The lights went out before a camera was ended, and of what shone then the device tells.
    ended = [line for line in ending.lines("note") if "no answer within 3 s" in line["said"]]
    assert len(ended) == 3
    assert dark["id"] < min(line["id"] for line in ended)
    full, after = ending.shone[1:3]
    assert full.counts.all()
    assert not after.counts.any()


def test_a_card_with_room_for_two_files_is_full_at_the_third_and_the_two_are_kept(stage):
    ending = stage.capture(settings={"cam2": {"card_files": 2}})
    for part in ("x- by cam2", "the card is full", "--resume"):
        assert part in ending.message
    assert ending.dark
    assert ending.shots() == ["full", "x+"]
    assert ending.kept() == sorted(set(PLAIN) - {"x-/cam2"})


@pytest.mark.parametrize("image_format", ["RAW", "RAW+JPEG"])
def test_what_comes_late_or_in_another_order_is_kept_under_its_own_name(stage, image_format):
    settings = {camera.id: {"image_format": image_format} for camera in stage.rig.cameras}
    faults = [
        Fault("slow", camera="cam0", at=2, seconds=0.4),
        Fault("event-storm", camera="cam1", at=1, until=3),
        Fault("other-order", at=1, until=3),
    ]
    ending = stage.capture(*faults, settings=settings)
    assert set(ending.happened) == {fault.name for fault in faults}
    assert ending.fine, ending.message
    assert ending.kept() == PLAIN
    assert ending.report.retakes == 0


def test_a_camera_that_makes_jpegs_is_refused_before_a_light_goes_on(stage):
    ending = stage.capture(settings={"cam1": {"image_format": "JPEG"}})
    assert "camera cam1, image_format: found JPEG" in ending.message
    assert ending.dark
    assert not ending.root.exists()


@pytest.mark.parametrize("name", ["wrong-iso", "drift"])
def test_a_setting_that_drifts_is_set_back_and_its_photograph_taken_again(stage, name):
    ending = stage.capture(Fault(name, camera="cam1", at=2))
    assert ending.fine, ending.message
    assert ending.happened == [name], ending.message
    assert "x+/cam1.take2" in ending.kept()
    # The first line is of this stage's fast lights, under which nobody sits.
    codes = [line["code"] for line in ending.lines("finding")]
    assert codes[:2] == ["photosensitivity", "drift"]
    assert any("set back" in line["said"] for line in ending.lines("note"))


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


def test_a_camera_that_hangs_is_ended_at_its_deadline_and_is_the_same_camera_afterwards(
    processes, tmp_path, seen
):
    cameras = processes(Fault("hang", camera="cam1", at=2))
    happened, problems = try_cameras(cameras)
    assert problems == []
    assert [summary.serial for summary in happened.values()] == ["600", "601", "602"]
    camera = cameras[1]
    assert names(camera.trigger(0.0)) == ["DSC_0001.DNG"]
    camera.deadlines = dataclasses.replace(camera.deadlines, trigger_s=0.5)
    pid = camera.pid
    with pytest.raises(DeviceError, match=r"camera cam1, trigger: found no answer within 0\.5 s"):
        camera.trigger(0.0)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert names(cameras[0].trigger(0.0)) == ["DSC_0001.DNG"]
    camera.deadlines = dataclasses.replace(camera.deadlines, trigger_s=20.0)
    assert camera.restart().serial == "601"
    # It counts on: the shot at which it hung has happened.
    taken = camera.trigger(0.0)
    assert names(taken) == ["DSC_0003.DNG"]
    camera.download(taken.files[0].name, tmp_path / "picture")
    assert (tmp_path / "picture").read_bytes() == seen(np.ones(8), 1)
    happened = read_fault_log(tmp_path / "faults.jsonl")
    assert [(each.device, each.name, each.count) for each in happened] == [("cam1", "hang", 2)]


def names(exposure):
    return [file.name.rpartition("/")[2] for file in exposure.files]


def fetched(camera, exposure, tmp_path):
    path = tmp_path / f"fetched-{len(list(tmp_path.glob('fetched-*')))}"
    camera.download(exposure.files[0].name, path)
    return path.read_bytes()


def test_a_camera_that_was_disconnected_comes_back(tmp_path, rig, seen, monkeypatch):
    fault = Fault("disconnect", camera="cam0", at=1, seconds=20)
    bodies = make_bodies(tmp_path, rig, seen, fault)
    now_s = [100.0]
    clock = types.SimpleNamespace(
        monotonic=lambda: now_s[0],
        sleep=lambda _: None,
        time=lambda: now_s[0],
        strftime=time.strftime,
        gmtime=time.gmtime,
    )
    monkeypatch.setattr(camera_body, "time", clock)
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    camera.open()
    with pytest.raises(DeviceError, match=r"error -7 .*unplugged"):
        camera.trigger(0.0)
    now_s[0] += 19
    with pytest.raises(DeviceError, match=r"error -105 .*No such camera is connected"):
        camera.open()
    with pytest.raises(DeviceError, match="not open"):
        camera.trigger(0.0)
    now_s[0] += 2
    camera.open()
    assert names(camera.trigger(0.0)) == ["DSC_0002.DNG"]


def test_the_file_of_a_shot_that_came_too_late_is_not_taken_for_the_next(tmp_path, rig, seen):
    bodies = make_bodies(tmp_path, rig, seen, Fault("late-file", camera="cam0", at=1))
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    camera.open()
    with pytest.raises(DeviceError, match="no file came of this shot"):
        camera.trigger(0.0)
    bodies.put("cam0", seen(np.zeros(8), 0))
    taken = camera.trigger(0.0)
    assert names(taken) == ["DSC_0002.DNG"]
    assert fetched(camera, taken, tmp_path) == seen(np.zeros(8), 0)


def test_of_a_pair_the_raw_is_taken_whatever_comes_first(tmp_path, rig, seen):
    faults = [Fault("other-order", camera="cam0", at=2)]
    bodies = make_bodies(tmp_path, rig, seen, *faults, cam0={"image_format": "RAW+JPEG"})
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    camera.open()
    for shot in (1, 2):
        taken = camera.trigger(0.0)
        assert names(taken) == [f"DSC_000{shot}.DNG", f"DSC_000{shot}.JPG"]
        assert fetched(camera, taken, tmp_path) == seen(np.ones(8), 0)


def test_every_setting_can_be_read_changed_and_drifts(tmp_path, rig, seen):
    drifts = [
        Fault("drift", camera="cam0", at=1),
        Fault("drift", camera="cam0", at=2, setting="focus", value="AF-S"),
        Fault("drift", camera="cam0", at=3, setting="battery_percent", value="7"),
        Fault("drift", camera="cam0", at=4, setting="clock_offset_s", value="-3600"),
    ]
    bodies = make_bodies(tmp_path, rig, seen, *drifts)
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    before = dataclasses.asdict(camera.open())
    for _ in drifts:
        camera.trigger(0.0)
    after = dataclasses.asdict(camera.summary())
    changed = {key: value for key, value in after.items() if value != before[key]}
    assert changed.pop("card_free_bytes") < before["card_free_bytes"]
    assert changed == {
        "white_balance": "Auto",
        "focus": "AF-S",
        "battery_percent": 7,
        "clock_offset_s": -3600.0,
    }
    camera.change("white_balance", "Daylight")
    assert camera.summary().white_balance == "Daylight"
    with pytest.raises(DeviceError, match="zoom: found unknown, expected one of serial, model"):
        camera.change("zoom", "3")
    with pytest.raises(DeviceError, match="battery_percent: found 'low', expected"):
        camera.change("battery_percent", "low")


def test_a_stop_more_light_doubles_the_counts_above_black(tmp_path, rig, seen):
    bodies = make_bodies(tmp_path, rig, seen, Fault("wrong-iso", camera="cam0", at=1, value="200"))
    camera = SimulatedCamera(str(bodies.folder("cam0")))
    assert camera.open().iso == "100"
    taken = _counts(fetched(camera, camera.trigger(0.0), tmp_path))
    known = _counts(seen(np.ones(8), 0))
    np.testing.assert_array_equal(taken, 512 + 2 * (known - 512))
    assert camera.open().iso == "200"
    camera.change("aperture", "f/16")
    np.testing.assert_allclose(
        _counts(fetched(camera, camera.trigger(0.0), tmp_path)), 512 + 0.5 * (known - 512), atol=0.5
    )


def test_the_same_fault_may_hit_every_camera_or_one(tmp_path, rig, seen):
    bodies = make_bodies(tmp_path, rig, seen, Fault("fail", at=1))
    for camera in rig.cameras:
        driver = SimulatedCamera(str(bodies.folder(camera.id)))
        driver.open()
        with pytest.raises(DeviceError, match="error -1"):
            driver.trigger(0.0)
    with pytest.raises(SimError, match=r"fault|story, fail, camera: found 'cam9'"):
        SimulatedCameras(tmp_path / "x", rig, Story([Fault("fail", camera="cam9")]))


def _counts(data):
    import io

    import tifffile

    return tifffile.imread(io.BytesIO(data)).astype(float)
