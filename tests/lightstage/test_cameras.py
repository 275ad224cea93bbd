"""Cameras in processes of their own, with libgphoto2's real virtual camera."""

import dataclasses
import io
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from lightstage.cameras import messages
from lightstage.cameras.binding import (
    CameraEntry,
    CamerasFile,
    bind_by_serial,
    binding_problems,
    close_cameras,
    find_cameras,
    open_cameras,
    read_cameras_file,
    summary_problems,
)
from lightstage.cameras.camera import Summary
from lightstage.cameras.process import CameraProcess, detect_ports
from lightstage.errors import ConfigError, DeviceError

PORT = "usb:001,001"


def folder(tmp_path, name="cam0", data=b"seed"):
    seed = tmp_path / name / "DCIM" / "100TEST" / "seed.jpg"
    seed.parent.mkdir(parents=True)
    seed.write_bytes(data)
    return tmp_path / name


def seed_of(camera):
    return camera.virtual_folder / "DCIM" / "100TEST" / "seed.jpg"


@pytest.fixture
def cameras(tmp_path):
    made = [
        CameraProcess(f"cam{i}", PORT, folder(tmp_path, f"cam{i}", os.urandom(40_000 + i)), 20.0)
        for i in range(3)
    ]
    yield made
    close_cameras(made)


def take_all(cameras):
    """What each camera gives: a photograph or its error."""

    def take(camera):
        try:
            return camera.capture(time.monotonic() + 0.05)
        except DeviceError as error:
            return error

    with ThreadPoolExecutor(len(cameras)) as pool:
        return list(pool.map(take, cameras))


def test_every_camera_gives_exactly_its_own_bytes_shot_after_shot(cameras):
    assert open_cameras(cameras)[1] == []
    for shot in range(3):
        for camera in cameras:
            seed = seed_of(camera)
            seed.write_bytes(bytes([shot]) + seed.read_bytes()[1:])
        photographs = take_all(cameras)
        assert [p.data for p in photographs] == [seed_of(c).read_bytes() for c in cameras]
        for photograph in photographs:
            assert photograph.triggered_s <= photograph.exposed_s <= photograph.downloaded_s


def test_a_camera_says_what_it_can_and_what_it_cannot(cameras):
    told = cameras[0].open()
    assert told.model == "Nikon DSC D750"
    assert told.shutter == "0.0100s"
    assert told.untold() == ["serial", "iso"]


def test_a_camera_that_fails_says_so_and_works_again(cameras):
    camera = cameras[0]
    camera.open()
    away = camera.virtual_folder / "away"
    os.rename(seed_of(camera), away)
    with pytest.raises(DeviceError, match=r"camera cam0 \(usb:001,001\), capture: .*error -1"):
        camera.capture(0)
    os.rename(away, seed_of(camera))
    assert camera.capture(0).data == seed_of(camera).read_bytes()


def test_a_hanging_camera_is_killed_at_its_deadline_and_the_others_photographs_are_there(cameras):
    open_cameras(cameras)
    hanging = cameras[1]
    os.unlink(seed_of(hanging))
    os.mkfifo(seed_of(hanging))  # libgphoto2 blocks in open(), as on a stuck USB transfer
    hanging.deadline_s = 1.0
    pid = hanging.pid
    first, second, third = take_all(cameras)
    assert first.data == seed_of(cameras[0]).read_bytes()
    assert third.data == seed_of(cameras[2]).read_bytes()
    assert "camera cam1, capture: found no answer within 1 s" in str(second)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_stopped_process_is_killed_too_and_can_be_opened_again(cameras):
    camera = cameras[0]
    camera.open()
    camera.deadline_s = 0.5
    os.kill(camera.pid, signal.SIGSTOP)
    with pytest.raises(DeviceError, match="no answer within"):
        camera.capture(0)
    with pytest.raises(DeviceError, match="camera cam0, capture"):
        camera.capture(0)
    camera.deadline_s = 20.0
    camera.open()
    assert camera.capture(0).data == seed_of(camera).read_bytes()


def test_a_process_that_dies_is_an_error_not_a_hang(cameras):
    open_cameras(cameras)
    os.kill(cameras[2].pid, signal.SIGKILL)
    results = take_all(cameras)
    assert "exit status -9" in str(results[2])
    assert [r.data for r in results[:2]] == [seed_of(c).read_bytes() for c in cameras[:2]]


def test_a_full_camera_says_that_its_memory_is_full(cameras):
    camera = cameras[0]
    camera.open()
    for _ in range(26):
        camera.capture(0)
    with pytest.raises(DeviceError, match=r"error -3 .*memory is full"):
        camera.capture(0)


def test_ctrl_c_of_the_terminal_does_not_reach_the_camera_processes(cameras):
    cameras[0].open()
    assert os.getpgid(cameras[0].pid) != os.getpgid(0)


def test_a_camera_process_ends_when_its_parent_is_killed(tmp_path):
    script = (
        "import time; from pathlib import Path\n"
        "from lightstage.cameras.process import CameraProcess\n"
        f"c = CameraProcess('cam0', '{PORT}', Path('{folder(tmp_path)}'), 20.0); c.open()\n"
        "print(c.pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    pid = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    for _ in range(100):
        status = Path(f"/proc/{pid}/stat")
        if not status.exists() or " Z " in status.read_text():
            return
        time.sleep(0.05)
    raise AssertionError("the camera process outlived its parent")


def test_no_camera_at_the_port_and_no_folder_are_told_apart(tmp_path):
    camera = CameraProcess("cam0", "usb:009,009", folder(tmp_path), 20.0)
    with pytest.raises(DeviceError, match="expected a camera at this port"):
        camera.open()
    camera.close()
    camera = CameraProcess("cam0", PORT, tmp_path / "none", 20.0)
    with pytest.raises(DeviceError, match="virtual_folder"):
        camera.open()
    camera.close()


def test_connected_cameras_are_listed_by_a_process_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("VCAMERADIR", str(folder(tmp_path)))
    assert detect_ports(20.0) == [("Nikon DSC D750", PORT)]


def test_a_camera_that_cannot_tell_its_serial_is_not_bound_by_it(tmp_path, monkeypatch, small_rig):
    monkeypatch.setenv("VCAMERADIR", str(folder(tmp_path)))
    with pytest.raises(DeviceError) as caught:
        find_cameras(small_rig, CamerasFile(), 20.0, detect_ports)
    said = str(caught.value)
    assert "4 problems" in said
    for camera in small_rig.cameras:
        assert f"camera {camera.id}, serial: found not connected" in said
    assert "port usb:001,001, serial: found a camera that cannot tell it" in said


def told(serial, model="Nikon DSC D750", iso="100"):
    return Summary(serial, model, iso, "1/60", "f/8")


def test_cameras_are_bound_by_serial_whatever_their_port(small_rig):
    found = [("c", told("601")), ("a", told("602")), ("b", told("600"))]
    bound, problems = bind_by_serial(small_rig.cameras, found)
    assert bound == {"cam0": "b", "cam1": "c", "cam2": "a"}
    assert problems == []


def test_missing_unknown_and_doubled_cameras_make_one_error_each(small_rig):
    found = [("a", told("600")), ("b", told("600")), ("c", told("999"))]
    _, problems = bind_by_serial(small_rig.cameras, found)
    said = "\n".join(map(str, problems))
    assert len(problems) == 4
    assert "camera cam0, serial: found 600 at a, b" in said
    assert "camera cam1, serial: found not connected" in said
    assert "port c, serial: found 999" in said


def test_what_cameras_tell_must_fit_the_rig(small_rig):
    summaries = [told("600"), told("700"), told(None, iso=None)]
    said = "\n".join(map(str, summary_problems(small_rig.cameras, summaries, ["iso"])))
    assert "camera cam1, serial: found 700, expected 601 (rig.json)" in said
    assert "camera cam2, serial: found not verifiable" in said
    assert "iso" not in said
    assert summary_problems(small_rig.cameras[:1], [told("600")], []) == []


def test_one_serial_for_several_cameras_is_an_error(small_rig):
    summaries = [told("600"), told("600"), told("602")]
    said = "\n".join(map(str, summary_problems(small_rig.cameras, summaries, [])))
    assert "cameras cam0, cam1, serial: found 600 for all of them" in said


def test_unknown_and_doubled_entries_of_the_cameras_file_are_all_told(small_rig, tmp_path):
    entry = CameraEntry(PORT, tmp_path)
    file = CamerasFile((), {"cam0": entry, "cam1": entry, "cam9": CameraEntry("usb:001,002")})
    said = "\n".join(map(str, binding_problems(small_rig, file)))
    assert "cameras cam0, cam1: found all at usb:001,001" in said
    assert "camera cam9: found an entry in the cameras file, none in the rig" in said


def test_a_driver_needs_a_port_and_nothing_of_libgphoto2s(small_rig, tmp_path):
    file = CamerasFile(
        (),
        {
            "cam0": CameraEntry(driver="a.b:c"),
            "cam1": CameraEntry("p", tmp_path, "a.b:c"),
            "cam2": CameraEntry("p", None, "a.b:c"),
        },
    )
    said = [str(problem) for problem in binding_problems(small_rig, file)]
    assert len(said) == 2
    assert "camera cam0, driver: found no port" in said[0]
    assert "camera cam1, driver: found a virtual_folder too" in said[1]


@pytest.mark.parametrize(
    ("driver", "said"),
    [
        ("no_such_module:Camera", r"driver: found No module named 'no_such_module', expected an"),
        (
            "json:Camera",
            "driver: found module 'json' has no attribute 'Camera', expected an installed module",
        ),
    ],
)
def test_a_driver_that_is_not_there_is_told_with_the_cameras_name(driver, said):
    camera = CameraProcess("cam4", "somewhere", None, 20.0, driver)
    with pytest.raises(DeviceError, match=r"camera cam4 \(somewhere\), " + said):
        camera.open()
    camera.close()


def test_a_cameras_file_names_the_driver_that_takes_the_photographs(small_rig, tmp_path):
    (tmp_path / "cameras.toml").write_text(
        '[cameras.cam0]\ndriver = "my.stage:Camera"\nport = "tcp:3"\n'
    )
    file = read_cameras_file(tmp_path / "cameras.toml")
    rig = dataclasses.replace(small_rig, cameras=small_rig.cameras[:1])
    (camera,) = find_cameras(rig, file, 20.0, detect_ports)
    assert (camera.driver, camera.port) == ("my.stage:Camera", "tcp:3")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[cameras.cam0]\ndriver = "my.stage"', "driver: found 'my.stage', expected package.mod"),
        ('[cameras.cam0]\ndriver = "my stage:x"', "expected package.module:name"),
        ('alow_unverifiable = ["iso"]', "alow_unverifiable: found an unknown key"),
        ('allow_unverifiable = ["colour"]', "found 'colour', expected of serial"),
        ('allow_unverifiable = "iso"', "expected tuple"),
        ('[cameras.cam0]\nprot = "usb"', "prot: found an unknown key"),
        ("[cameras.cam0]\nport = 3", "port: found 3, expected str"),
        ('[cameras]\ncam0 = "usb"', "expected a table"),
        ("[cameras", "valid TOML"),
    ],
)
def test_a_malformed_cameras_file_is_refused(tmp_path, text, said):
    path = tmp_path / "cameras.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_cameras_file(path)


def test_folders_in_the_cameras_file_are_relative_to_it(tmp_path):
    path = tmp_path / "cameras.toml"
    path.write_text('[cameras.cam0]\nport = "usb:001,001"\nvirtual_folder = "v/cam0"')
    assert read_cameras_file(path).cameras["cam0"].virtual_folder == tmp_path / "v" / "cam0"


def test_messages_survive_their_stream():
    sent = [({"a": 1}, b""), ({"b": [2]}, os.urandom(1000))]
    stream = io.BytesIO(b"".join(messages.head(v, len(d)) + d for v, d in sent))
    assert [messages.read(stream.read), messages.read(stream.read)] == sent
    assert messages.read(stream.read) is None
    first = len(messages.head(*sent[0][:1]))
    for size in range(len(stream.getvalue()) - 1, first, -97):
        cut = io.BytesIO(stream.getvalue()[first:size])
        assert messages.read(cut.read) is None
    with pytest.raises(ValueError, match="no message"):
        messages.read(io.BytesIO(b"Traceback (most recent").read)
