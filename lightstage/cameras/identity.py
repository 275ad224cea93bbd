"""Whether connected cameras are those of the rig, each in its place: pure, no camera is asked."""

from __future__ import annotations

import collections
from collections.abc import Sequence

from lightstage.cameras.camera import Summary
from lightstage.cameras.cameras_file import CamerasFile
from lightstage.errors import DeviceError, LightstageError
from lightstage.rig import Camera, Rig

IDENTITY = ("serial", "model")
"""What binds a camera to its place; preflight checks the rest."""


def binding_problems(rig: Rig, file: CamerasFile) -> list[LightstageError]:
    """What is wrong with a cameras file before any camera is asked."""
    problems: list[LightstageError] = []
    known = [camera.id for camera in rig.cameras]
    bare = [camera_id for camera_id in known if camera_id not in file.cameras]
    for camera_id, entry in file.cameras.items():
        if camera_id not in known:
            problems.append(
                DeviceError(
                    f"camera {camera_id}",
                    found="an entry in the cameras file, none in the rig",
                    expected=f"one of {', '.join(known)}",
                    hint=f"Without an entry: {', '.join(bare)}." if bare else "",
                )
            )
        if entry.driver is not None and (entry.port is None or entry.virtual_folder is not None):
            problems.append(
                DeviceError(
                    f"camera {camera_id}",
                    field="driver",
                    found="no port" if entry.port is None else "a virtual_folder too",
                    expected="driver and port, and nothing else",
                )
            )
        elif entry.virtual_folder is not None and entry.port is None:
            problems.append(
                DeviceError(
                    f"camera {camera_id}",
                    field="virtual_folder",
                    found="no port",
                    expected='port = "usb:001,001", where the virtual camera is',
                )
            )
    places = collections.defaultdict(list)
    for camera_id, entry in file.cameras.items():
        if entry.port is not None:
            places[entry.port, entry.virtual_folder, entry.driver].append(camera_id)
    for (port, folder, _), ids in places.items():
        if len(ids) > 1:
            problems.append(
                DeviceError(
                    f"cameras {', '.join(ids)}",
                    found=f"all at {port}" + (f" of {folder}" if folder else ""),
                    expected="a port of its own each",
                )
            )
    return problems


def summary_problems(
    cameras: Sequence[Camera], summaries: Sequence[Summary], allow_unverifiable: Sequence[str]
) -> list[LightstageError]:
    """Where cameras contradict the rig or each other, or cannot identify themselves, unallowed.

    Args:
        cameras: the rig's, in the order of `summaries`.
        summaries: as the devices report them.
        allow_unverifiable: names that a camera may be unable to report.
    """
    owners = {camera.serial: camera.id for camera in cameras}
    found_at = {
        camera.id: owners[summary.serial]
        for camera, summary in zip(cameras, summaries, strict=True)
        if summary.serial in owners
    }
    rounds = _exchanged(found_at)
    exchanged = {camera_id for one in rounds for camera_id in one}
    problems: list[LightstageError] = [_swap(one) for one in rounds]
    for camera, summary in zip(cameras, summaries, strict=True):
        for name, wanted in (("serial", camera.serial), ("model", camera.model)):
            found = getattr(summary, name)
            if found is None or found == wanted or camera.id in exchanged:
                continue
            other = owners.get(found) if name == "serial" else None
            problems.append(
                DeviceError(
                    f"camera {camera.id}",
                    field=name,
                    found=found,
                    expected=f"{wanted} (rig.json)",
                    hint=f"That one is {other} of the rig."
                    if other is not None
                    else "Is another camera at this port?",
                )
            )
        untold = [name for name in IDENTITY if getattr(summary, name) is None]
        refused = [name for name in untold if name not in allow_unverifiable]
        if refused:
            problems.append(
                DeviceError(
                    f"camera {camera.id}",
                    field=", ".join(refused),
                    found="not verifiable: the camera cannot report it",
                    expected="a camera that reports it, or the name in allow_unverifiable",
                    hint="Allow it in the cameras file if you made sure by eye.",
                )
            )
    serials = collections.Counter(s.serial for s in summaries if s.serial is not None)
    for serial, count in serials.items():
        if count > 1:
            ids = [c.id for c, s in zip(cameras, summaries, strict=True) if s.serial == serial]
            problems.append(
                DeviceError(
                    f"cameras {', '.join(ids)}",
                    field="serial",
                    found=f"{serial} for all of them",
                    expected="one camera each",
                )
            )
    return problems


def _exchanged(found_at: dict[str, str]) -> list[list[str]]:
    """Rounds of cameras of which each is where the next one should be.

    Args:
        found_at: a camera's id to that of the camera which is in its place; own places too.
    """
    rounds: list[list[str]] = []
    seen: set[str] = set()
    for start in found_at:
        one: list[str] = []
        here = start
        while here in found_at and here not in seen:
            seen.add(here)
            one.append(here)
            here = found_at[here]
        if here == start and len(one) > 1:
            rounds.append(one)
    return rounds


def _swap(ids: list[str]) -> DeviceError:
    if len(ids) == 2:
        found = f"swapped: {ids[1]} is in the place of {ids[0]}, and {ids[0]} in that of {ids[1]}"
    else:
        places = zip(ids, [*ids[1:], ids[0]], strict=True)
        found = "changed round: " + ", ".join(f"{b} is in the place of {a}" for a, b in places)
    return DeviceError(
        f"cameras {', '.join(ids)}",
        field="serial",
        found=found,
        expected="each serial number in its own place (rig.json)",
        hint="Exchange their ports in the cameras file; if the cameras themselves were exchanged "
        "on the stage, put them back: their calibration goes with the place.",
    )


def bind_by_serial(
    wanted: Sequence[Camera], candidates: Sequence[tuple[str, Summary]]
) -> tuple[dict[str, str], list[LightstageError]]:
    """Match cameras to ports by serial number.

    Args:
        wanted: cameras of the rig without a port.
        candidates: port and the summary of the camera there.

    Returns:
        Camera id to port, and one error for each camera that is missing, unknown or there twice.
    """
    problems: list[LightstageError] = []
    ports = collections.defaultdict(list)
    for port, summary in candidates:
        ports[summary.serial].append(port)
    bound = {}
    for camera in wanted:
        here = ports.pop(camera.serial, [])
        if len(here) == 1:
            bound[camera.id] = here[0]
            continue
        problems.append(
            DeviceError(
                f"camera {camera.id}",
                field="serial",
                found=f"{camera.serial} at {', '.join(here)}" if here else "not connected",
                expected=f"one camera with serial {camera.serial}",
                hint="Check its cable and power, or give its port in the cameras file.",
            )
        )
    for serial, unknown in ports.items():
        problems.append(
            DeviceError(
                f"port {', '.join(unknown)}",
                field="serial",
                found=serial or "a camera that cannot report it",
                expected="a serial number of rig.json",
                hint="Add the camera to the rig, unplug it, or give its port in the cameras file.",
            )
        )
    return bound, problems
