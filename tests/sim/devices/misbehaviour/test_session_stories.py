"""Stories of whole sessions: `lightstage capture` and its cameras as processes of their own."""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.cameras.binding import close_cameras, try_cameras
from lightstage.cameras.process import CameraProcess, Deadlines
from lightstage.errors import DeviceError
from lightstage.formats.session import load_session
from sim.devices.camera_device import PORT, CameraFolders
from sim.devices.capture import capture_session
from sim.devices.faults import Fault, FaultLog, Story, read_fault_log
from sim.devices.photographer import Photographer
from sim.errors import SimError
from sim.light.world import World
from sim.session import faults_path


@pytest.fixture(scope="module")
def world(ball, tiny_rig):
    return World(ball, tiny_rig)


def test_a_day_with_a_bad_cable_and_a_slow_camera_ends_in_a_whole_session(
    world, tmp_path, tiny_rig
):
    story = Story(
        [
            Fault("duplicate", at=3),
            Fault("corrupt", at=6, way="answer", bits=2),
            Fault("slow", camera="cam0", at=1, seconds=0.4),
            Fault("event-storm", camera="cam1", at=2),
        ]
    )
    out = tmp_path / "s"
    capture_session(world, out, 5, "full,x+", story=story)
    happened = read_fault_log(faults_path(out))
    assert sorted(each.name for each in happened) == ["corrupt", "duplicate", "event-storm", "slow"]
    session = load_session(out)
    photographer = Photographer(world, 5)
    counts = 2 * tiny_rig.cameras[0].width_px * tiny_rig.cameras[0].height_px
    for frame in session.file.frames:
        levels = session.levels(frame.pattern)
        known = photographer.photograph(tiny_rig.camera(frame.camera), levels)
        kept = session.frame_path(frame).read_bytes()
        # The body writes its settings and the time into the headers; the light is the same.
        assert kept[-counts:] == known[-counts:]
        assert len(kept) == len(known)


def test_a_day_on_which_a_camera_dies_reports_it_and_leaves_no_finished_session(
    world, tmp_path, capfd
):
    story = Story([Fault("battery-empty", camera="cam1", at=2)])
    config = tmp_path / "config.toml"
    config.write_text("[deadlines]\nabsent_s = 0.5\n")  # it will not come back
    with pytest.raises(SimError, match="exit code 2"):
        capture_session(world, tmp_path / "s", 5, "full,x+", story=story, config=config)
    printed = capfd.readouterr().err
    assert "x+ by cam1" in printed
    assert "its battery is empty" in printed
    assert (
        "Put in a full battery and switch it on. It does not start again: no camera at any port"
        in printed
    )
    assert "lightstage capture --resume" in printed
    assert (tmp_path / "s" / "frames" / "x+" / "cam0.dng").is_file()
    assert not (tmp_path / "s" / "session.json").exists()
    (finding,) = read_fault_log(faults_path(tmp_path / "s"))
    assert (finding.device, finding.name, finding.counted, finding.count) == (
        *("cam1", "battery-empty", "shot", 2),
    )


def test_a_story_that_cannot_be_told_is_refused_before_anything_is_made(tmp_path, run_command):
    path = tmp_path / "faults.toml"
    path.write_text("[[fault]]\nname = 'fail'\ncamera = 'cam99'")
    words = ("session", "--subject", "P1", "--faults", path, "--out", tmp_path / "s")
    ended = run_command("sim", *words)
    assert ended.code == 2
    assert "found 'cam99', expected one of cam0" in ended.err
    assert "Traceback" not in ended.err
    assert [each.name for each in tmp_path.iterdir()] == ["faults.toml"]


def test_libgphoto2s_virtual_cameras_fail_hang_and_repeat_themselves_as_told(tmp_path):
    """What files can do to them, and that they are well again with the next light."""
    names = ["fail", "hang", "stale", "truncated"]
    log = FaultLog()
    folders = CameraFolders(
        tmp_path, names, Story([Fault(name, camera=name, at=2) for name in names]), log
    )
    rng = np.random.default_rng(3)
    seen: list[bytes] = []

    def change_light():
        seen.append(rng.bytes(50_000))
        for name in names:
            folders.put(name, seen[-1])

    cameras = [CameraProcess(name, PORT, folders.folder(name), 20.0) for name in names]
    paths = map(str, range(99))

    def shot(camera):
        path = tmp_path / next(paths)
        camera.download(camera.trigger(0.0).files[0].name, path)
        return path.read_bytes()

    try:
        change_light()
        assert try_cameras(cameras)[1] == []
        change_light()
        assert {shot(camera) for camera in cameras} == {seen[1]}
        change_light()
        fail, hang, stale, truncated = cameras
        with pytest.raises(DeviceError, match="error -1"):
            shot(fail)
        hang.deadlines = Deadlines.all(0.4)
        with pytest.raises(DeviceError, match=r"no answer within 0\.4"):
            shot(hang)
        assert shot(stale) == seen[1]
        with pytest.raises(DeviceError, match=r"error|expected 50000 bytes"):
            shot(truncated)
        change_light()
        hang.deadlines = Deadlines.all(20.0)
        hang.restart()
        assert shot(hang) == shot(fail) == shot(stale) == seen[3]
        assert sorted(log.names()) == names
    finally:
        close_cameras(cameras)


def test_what_files_cannot_do_to_a_virtual_camera_is_refused(tmp_path):
    with pytest.raises(SimError, match=r"fault wrong-iso: .* expected one of fail, hang, stale"):
        CameraFolders(tmp_path, ["cam0"], Story([Fault("wrong-iso")]))
    with pytest.raises(SimError, match="found 'cam7', expected one of cam0"):
        CameraFolders(tmp_path, ["cam0"], Story([Fault("stale", camera="cam7")]))
