"""Whether connected cameras are those of the rig, each in its place."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.cameras.binding import (
    CameraEntry,
    CamerasFile,
    connect_problems,
    find_cameras,
)
from lightstage.cameras.camera import VERIFIABLE, Summary
from lightstage.cameras.identity import (
    bind_by_serial,
    binding_problems,
    summary_problems,
)
from lightstage.cameras.process import CameraProcess, detect_ports
from lightstage.errors import DeviceError

PORT = "usb:001,001"
BUT_NAMES = [name for name in VERIFIABLE if name not in ("serial", "model", "iso")]


def summary_of(serial, model="Nikon DSC D750", iso="100"):
    return Summary(serial=serial, model=model, iso=iso)


def problems_of(rig, serials, allowed=BUT_NAMES):
    problems = summary_problems(rig.cameras, [summary_of(serial) for serial in serials], allowed)
    return [str(problem) for problem in problems]


def test_cameras_are_bound_by_serial_whatever_their_port(small_rig):
    found = [("c", summary_of("601")), ("a", summary_of("602")), ("b", summary_of("600"))]
    bound, problems = bind_by_serial(small_rig.cameras, found)
    assert bound == {"cam0": "b", "cam1": "c", "cam2": "a"}
    assert problems == []


def test_missing_unknown_and_doubled_cameras_make_one_error_each(small_rig):
    found = [("a", summary_of("600")), ("b", summary_of("600")), ("c", summary_of("999"))]
    _, problems = bind_by_serial(small_rig.cameras, found)
    message = "\n".join(map(str, problems))
    assert len(problems) == 4
    assert "camera cam0, serial: found 600 at a, b" in message
    assert "camera cam1, serial: found not connected" in message
    assert "port c, serial: found 999" in message


def test_what_cameras_report_must_fit_the_rig(small_rig):
    summaries = [summary_of("600"), summary_of("700"), summary_of(None, iso=None)]
    allowed = [*BUT_NAMES, "iso"]
    message = "\n".join(map(str, summary_problems(small_rig.cameras, summaries, allowed)))
    assert "camera cam1, serial: found 700, expected 601 (rig.json)" in message
    assert "camera cam2, serial: found not verifiable" in message
    assert "iso" not in message
    assert summary_problems(small_rig.cameras[:1], [summary_of("600")], BUT_NAMES) == []


def test_who_a_camera_is_must_be_reported_or_allowed_by_name(small_rig):
    allowed = [*BUT_NAMES, "iso"]
    unknown = [Summary(serial=None, model=None)]
    (problem,) = summary_problems(small_rig.cameras[:1], unknown, allowed)
    assert "camera cam0, serial, model: found not verifiable: the camera cannot report it" in str(
        problem
    )
    assert summary_problems(small_rig.cameras[:1], unknown, VERIFIABLE) == []


def test_one_serial_for_several_cameras_is_an_error(small_rig):
    message = "\n".join(problems_of(small_rig, ["600", "600", "602"]))
    assert "cameras cam0, cam1, serial: found 600 for all of them" in message
    assert "camera cam1, serial: found 600, expected 601 (rig.json). That one is cam0" in message


def test_two_cameras_in_each_others_place_are_reported_as_swapped_and_only_so(small_rig):
    (text,) = problems_of(small_rig, ["602", "601", "600"])
    assert "cameras cam0, cam2, serial: found swapped: cam2 is in the place of cam0" in text
    assert "Exchange their ports in the cameras file" in text


def test_three_cameras_changed_round_are_reported_as_one(small_rig):
    (text,) = problems_of(small_rig, ["601", "602", "600"])
    assert "changed round: cam1 is in the place of cam0, cam2 is in the place of cam1" in text


@given(st.permutations(range(3)), st.sets(st.integers(0, 2)))
def test_any_disorder_is_refused_and_order_is_not(order, strangers):
    rig = _rig()
    serials = [f"x{i}" if i in strangers else f"60{i}" for i in order]
    text = problems_of(rig, serials)
    assert bool(text) == (serials != ["600", "601", "602"])
    for number, serial in enumerate(serials):
        if serial != f"60{number}":
            assert any(f"cam{number}" in line for line in text)


def _rig():
    """Cameras alone, without the fixture that hypothesis may not reset."""

    @dataclasses.dataclass
    class Named:
        id: str
        serial: str
        model: str = "Nikon DSC D750"

    @dataclasses.dataclass
    class Cameras:
        cameras: tuple

    return Cameras(tuple(Named(f"cam{i}", f"60{i}") for i in range(3)))


def test_unknown_and_doubled_entries_of_the_cameras_file_are_all_reported(small_rig, tmp_path):
    entry = CameraEntry(PORT, tmp_path)
    file = CamerasFile(cameras={"cam0": entry, "cam1": entry, "cam9": CameraEntry("usb:001,002")})
    message = "\n".join(map(str, binding_problems(small_rig, file)))
    assert "cameras cam0, cam1: found all at usb:001,001" in message
    assert "camera cam9: found an entry in the cameras file, none in the rig" in message
    assert "Without an entry: cam2" in message


def test_a_driver_needs_a_port_and_nothing_of_libgphoto2s(small_rig, tmp_path):
    file = CamerasFile(
        cameras={
            "cam0": CameraEntry(driver="a.b:c"),
            "cam1": CameraEntry("p", tmp_path, "a.b:c"),
            "cam2": CameraEntry("p", None, "a.b:c"),
        },
    )
    message = [str(problem) for problem in binding_problems(small_rig, file)]
    assert len(message) == 2
    assert "camera cam0, driver: found no port" in message[0]
    assert "camera cam1, driver: found a virtual_folder too" in message[1]


def three(fake, ports):
    for number in range(3):
        fake.make_body(f"60{number}")
    fake.plug(ports)


def test_cameras_are_found_at_any_port_by_processes_that_look(fake, small_rig, processes):
    three(fake, {"usb:001,007": "601", "usb:001,008": "602", "usb:002,001": "600"})
    processes += find_cameras(small_rig, CamerasFile(), 20.0, detect_ports)
    assert [camera.port for camera in processes] == ["usb:002,001", "usb:001,007", "usb:001,008"]
    assert [camera.open().serial for camera in processes] == ["600", "601", "602"]


def test_missing_unknown_and_wrongly_placed_cameras_make_one_message(fake, small_rig):
    """cam0's port is given and holds another's body; cam1 is missing; a stranger is there."""
    three(fake, {"usb:001,007": "602", "usb:001,008": "999"})
    fake.make_body("999")
    file = CamerasFile(
        ("place", "owner", "clock_offset_s"), {}, {"cam0": CameraEntry("usb:001,007")}
    )
    with pytest.raises(DeviceError) as caught:
        find_cameras(small_rig, file, 20.0, detect_ports)
    message = str(caught.value)
    assert "4 problems" in message
    assert "camera cam1, serial: found not connected" in message
    assert "camera cam2, serial: found not connected" in message
    assert "port usb:001,008, serial: found 999" in message
    assert "camera cam0, serial: found 602, expected 600" in message


def test_a_camera_at_another_port_than_the_files_is_found_by_its_serial_number(
    fake, small_rig, processes
):
    """cam0's port has a stranger's body, nothing is at cam1's, cam2 is where it should be."""
    fake.make_body("999")
    ports = {"usb:001,007": "999", "usb:001,009": "602", "usb:001,010": "601", "usb:001,011": "600"}
    three(fake, ports)
    given = ["usb:001,007", "usb:001,008", "usb:001,009"]
    for camera, port in zip(small_rig.cameras, given, strict=True):
        processes.append(CameraProcess(camera.id, port, None, 20.0))
    allowed = ("place", "owner", "clock_offset_s")
    moved = []
    summary_of, problems = connect_problems(small_rig.cameras, processes, allowed, moved)
    assert problems == []
    assert [summary_of[camera.id].serial for camera in small_rig.cameras] == ["600", "601", "602"]
    assert [(m.camera, m.port, m.there, m.found) for m in moved] == [
        ("cam0", "usb:001,007", "999", "usb:001,011"),
        ("cam1", "usb:001,008", None, "usb:001,010"),
    ]


def test_a_camera_that_is_at_no_port_keeps_its_own_message(fake, small_rig, processes):
    fake.make_body("999")
    three(fake, {"usb:001,007": "999", "usb:001,008": "601", "usb:001,009": "602"})
    ports = ["usb:001,007", "usb:001,008", "usb:001,009"]
    for camera, port in zip(small_rig.cameras, ports, strict=True):
        processes.append(CameraProcess(camera.id, port, None, 20.0))
    moved = []
    allowed = ("place", "owner", "clock_offset_s")
    _, problems = connect_problems(small_rig.cameras, processes, allowed, moved)
    assert moved == []
    assert len(problems) == 1
    assert "camera cam0, serial: found 999, expected 600 (rig.json)" in str(problems[0])


def test_a_camera_that_does_not_open_hides_nothing_about_the_others(fake, small_rig, processes):
    three(fake, {"usb:001,007": "601", "usb:001,008": "600"})
    ports = ["usb:001,007", "usb:001,008", "usb:001,009"]
    for camera, port in zip(small_rig.cameras, ports, strict=True):
        processes.append(CameraProcess(camera.id, port, None, 20.0))
    allowed = ("place", "owner", "clock_offset_s")
    summary_of, problems = connect_problems(small_rig.cameras, processes, allowed)
    assert list(summary_of) == ["cam0", "cam1"]
    text = sorted(map(str, problems))
    assert len(text) == 2
    assert "port usb:001,009): found Nikon DSC D750 at usb:001,007" in text[0]
    assert "swapped: cam1 is in the place of cam0, and cam0 in that of cam1" in text[1]
