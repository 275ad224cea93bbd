"""A camera that was lost is found again by its serial number, and no other one is disturbed."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

from lightstage.cameras.process import CameraProcess, Deadlines
from lightstage.errors import DeviceError
from tests.waiting import until

A, B, C = "usb:001,004", "usb:001,005", "usb:001,009"


@pytest.fixture
def two(fake, processes):
    """Two bodies, each in its process."""
    fake.make_body("6002")
    fake.plug({A: "6001", B: "6002"})
    for name, port in (("cam1", A), ("cam2", B)):
        processes.append(CameraProcess(name, port, None, 20.0))
        processes[-1].open()
    return processes


def test_a_killed_camera_is_the_same_one_afterwards_at_its_port(two):
    os.kill(two[0].pid, signal.SIGKILL)
    with pytest.raises(DeviceError, match="exit status -9"):
        two[0].trigger(0.0)
    assert two[0].restart().serial == "6001"
    assert two[0].trigger(0.0).files[0].name.endswith("DSC_0001.NEF")


def test_a_camera_at_another_port_is_found_there_and_the_other_one_is_left_alone(two, fake):
    fake.plug({B: "6002", C: "6001"})
    before = fake.body_of("6002")["calls"]
    assert two[0].restart().serial == "6001"
    assert two[0].port == C
    assert fake.body_of("6002")["calls"] == before
    assert two[1].trigger(0.0).files


def test_cameras_whose_cables_were_exchanged_are_both_found(two, fake):
    fake.plug({A: "6002", B: "6001"})
    for camera in two:
        os.kill(camera.pid, signal.SIGKILL)
    assert [camera.restart().serial for camera in two] == ["6001", "6002"]
    assert [camera.port for camera in two] == [B, A]


def test_a_stranger_at_its_port_is_let_go_again_and_reported(two, fake):
    fake.make_body("7777")
    fake.plug({A: "7777", B: "6002"})
    two[0].deadlines = Deadlines(absent_s=60.0)
    lines = []

    def restart():
        try:
            two[0].restart()
        except DeviceError as error:
            lines.append(str(error))

    thread = threading.Thread(target=restart)
    thread.start()
    until(lambda: fake.body_of("7777")["calls"].count("exit") >= 2)
    two[0].close()  # it would look on until its deadline
    thread.join(20)
    assert "camera cam1, restart: found usb:001,004: found serial 7777" in lines[0]
    assert "expected the camera with serial 6001" in lines[0]
    with pytest.raises(DeviceError, match="not open"):
        two[0].trigger(0.0)


def test_a_camera_that_comes_back_after_a_while_is_waited_for(two, fake):
    fake.plug({B: "6002"})
    two[0].deadlines = Deadlines(absent_s=20.0)
    later = threading.Timer(0.6, lambda: fake.plug({B: "6002", C: "6001"}))
    later.start()
    assert two[0].restart().serial == "6001"
    later.join()


def test_a_camera_that_another_program_grabs_when_it_is_plugged_in_is_asked_again(two, fake):
    body = fake.body_of("6001")
    fake.put(fake.root() / "6001" / "body.json", body | {"answers": {"init": [-53, -53]}})
    assert two[0].restart().serial == "6001"


def test_a_port_that_hangs_does_not_hide_the_others(two, fake, monkeypatch):
    """Where it was, something never answers; it stands at another port meanwhile."""
    monkeypatch.setenv("FAKE_HANGS", A)
    fake.make_body("8888")
    fake.plug({A: "8888", B: "6002", C: "6001"})
    two[0].deadlines = Deadlines(open_s=5.0, absent_s=1.0)
    began_s = time.monotonic()
    assert two[0].restart().serial == "6001"
    assert time.monotonic() - began_s >= 3.0  # it did ask the one that hangs first


def test_a_camera_that_stays_away_is_given_up(two, fake):
    fake.plug({B: "6002"})
    two[0].deadlines = Deadlines(absent_s=0.3)
    with pytest.raises(DeviceError, match=r"cam1, restart: found no camera at any port, expected"):
        two[0].restart()
