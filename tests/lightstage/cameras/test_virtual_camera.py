"""Cameras in processes of their own, with libgphoto2's real virtual camera."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from lightstage.cameras.binding import (
    CamerasFile,
    find_cameras,
    try_cameras,
)
from lightstage.cameras.process import CameraProcess, Deadlines, detect_ports
from lightstage.errors import CaptureError, DeviceError

PORT = "usb:001,001"


@pytest.fixture
def cameras(virtual):
    return [virtual.camera(f"cam{number}", 40_000 + number) for number in range(3)]


def take_all(cameras, root):
    """What each camera gives: a photograph's bytes or its error."""
    root.mkdir(exist_ok=True)

    def take(camera):
        try:
            exposure = camera.trigger(time.monotonic() + 0.05)
            path = root / f"{camera.id}-{exposure.files[0].name.rpartition('/')[2]}"
            camera.download(exposure.files[0].name, path)
        except DeviceError as error:
            return error
        return path.read_bytes()

    with ThreadPoolExecutor(len(cameras)) as pool:
        return list(pool.map(take, cameras))


def test_every_camera_gives_exactly_its_own_bytes_shot_after_shot(cameras, virtual, tmp_path):
    assert try_cameras(cameras)[1] == []
    for shot in range(5):
        for camera in cameras:
            seed = virtual.seed(camera)
            seed.write_bytes(bytes([shot]) + seed.read_bytes()[1:])
        seen = [virtual.seed(camera).read_bytes() for camera in cameras]
        assert take_all(cameras, tmp_path / "out") == seen


def test_it_states_what_it_can_and_what_it_cannot(cameras):
    summary = cameras[0].open()
    assert (summary.model, summary.firmware) == ("Nikon DSC D750", "2.5.11")
    assert (summary.shutter, summary.aperture) == ("0.0100s", "f/2.8")
    assert summary.battery_percent == 50.0
    assert summary.card_free_bytes > 0
    assert abs(summary.clock_offset_s) < 60
    assert summary.not_readable() == [
        *("serial", "mode", "iso", "white_balance", "image_format", "focus"),
        *("owner", "artist", "copyright", "place"),
    ]


def test_its_shutter_is_changed_and_read_back(cameras):
    camera = cameras[0]
    camera.open()
    camera.change("shutter", "0.0200s")
    assert camera.summary().shutter == "0.0200s"
    with pytest.raises(DeviceError, match=r"shutter: found '7 s', expected of 1"):
        camera.change("shutter", "7 s")


def test_its_card_shows_what_was_taken_until_it_is_deleted_or_its_process_ends(cameras):
    """It remembers nothing beyond its process, and names its pictures anew."""
    camera = cameras[0]
    camera.open()
    (seed,) = camera.card()
    assert seed.name.endswith("/seed.jpg")
    first, second = (camera.trigger(0.0).files[0] for _ in range(2))
    assert set(camera.card()) == {seed, first, second}
    camera.delete(first.name)
    assert set(camera.card()) == {seed, second}
    camera.restart()
    assert camera.card() == (seed,)
    assert camera.trigger(0.0).files[0] == first


def test_a_camera_that_fails_reports_it_and_works_again(cameras, virtual, tmp_path):
    camera = cameras[0]
    camera.open()
    seed = virtual.seed(camera)
    away = camera.virtual_folder / "away"
    os.rename(seed, away)
    with pytest.raises(DeviceError, match=r"camera cam0 \(usb:001,001\), trigger: .*error -1"):
        camera.trigger(0.0)
    os.rename(away, seed)
    assert take_all([camera], tmp_path / "out") == [seed.read_bytes()]


def test_one_that_hangs_in_the_library_is_killed_and_comes_back(cameras, virtual, tmp_path):
    try_cameras(cameras)
    hanging, seed = cameras[1], virtual.seed(cameras[1])
    os.rename(seed, tmp_path / "away")
    os.mkfifo(seed)  # libgphoto2 blocks in open(), as on a stuck USB transfer
    hanging.deadlines = Deadlines.all(1.0)
    pid = hanging.pid
    first, second, third = take_all(cameras, tmp_path / "out")
    assert first == virtual.seed(cameras[0]).read_bytes()
    assert third == virtual.seed(cameras[2]).read_bytes()
    assert "camera cam1, trigger: found no answer within 1" in str(second)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    os.replace(tmp_path / "away", seed)
    hanging.deadlines = Deadlines.all(20.0)
    hanging.restart()
    assert take_all([hanging], tmp_path / "out") == [seed.read_bytes()]


def test_a_full_camera_fails_at_its_27th_shot_and_is_brought_back_by_a_restart(virtual, tmp_path):
    """Its store is full then; asked again, it may take its process with it."""
    camera = virtual.camera("cam0")
    camera.deadlines = Deadlines(trigger_s=2.0)
    camera.open()
    for _ in range(26):
        camera.trigger(0.0)
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"camera cam0.*trigger: "):
            camera.trigger(0.0)
    camera.restart()
    assert take_all([camera], tmp_path / "out") == [virtual.seed(camera).read_bytes()]


FULL = """
import sys
from pathlib import Path
from lightstage.cameras.gphoto import GphotoCamera
from lightstage.errors import DeviceError
camera = GphotoCamera("usb:001,001", Path(sys.argv[1]))
camera.open()
library = camera._link.library
kind = library.GP_OPERATION_TRIGGER_CAPTURE
class Abilities:
    operations = camera._link.camera.get_abilities().operations & ~kind
camera._link.camera.get_abilities = lambda: Abilities
for _ in range(26):
    camera.trigger(0.0)
try:
    camera.trigger(0.0)
except DeviceError as error:
    print(error)
"""


def test_a_camera_that_captures_in_one_call_reports_that_its_memory_is_full(virtual):
    folder = virtual.folder("cam0", b"picture" * 1000)
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(folder)], capture_output=True, text=True, timeout=60
    )
    assert "error -3" in done.stdout, done.stderr
    assert "Copy its photographs away and format it" in done.stdout


def test_a_photograph_is_never_written_over_another_file(cameras, tmp_path):
    camera = cameras[0]
    camera.open()
    (tmp_path / "there").write_bytes(b"another photograph")
    with pytest.raises(CaptureError, match=r"camera cam0 \(.*there\), write: found File exists"):
        camera.download(camera.card()[0].name, tmp_path / "there")
    assert (tmp_path / "there").read_bytes() == b"another photograph"


def test_no_camera_at_the_port_and_no_folder_are_distinguished(virtual, processes, tmp_path):
    folder = virtual.folder("cam0", b"seed")
    processes.append(CameraProcess("cam0", "usb:009,009", folder, 20.0))
    with pytest.raises(DeviceError, match="expected a camera at this port"):
        processes[0].open()
    processes.append(CameraProcess("cam0", PORT, tmp_path / "none", 20.0))
    with pytest.raises(DeviceError, match="virtual_folder"):
        processes[1].open()


def test_connected_cameras_are_listed_by_a_process_of_its_own(virtual, monkeypatch):
    monkeypatch.setenv("VCAMERADIR", str(virtual.folder("cam0", b"seed")))
    assert detect_ports(20.0) == [("Nikon DSC D750", PORT)]


def test_a_camera_that_cannot_state_its_serial_is_not_bound_by_it(virtual, monkeypatch, small_rig):
    monkeypatch.setenv("VCAMERADIR", str(virtual.folder("cam0", b"seed")))
    with pytest.raises(DeviceError) as caught:
        find_cameras(small_rig, CamerasFile(), 20.0, detect_ports)
    message = str(caught.value)
    assert "4 problems" in message
    for camera in small_rig.cameras:
        assert f"camera {camera.id}, serial: found not connected" in message
    assert "port usb:001,001, serial: found a camera that cannot report it" in message
