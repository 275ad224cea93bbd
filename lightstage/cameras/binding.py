"""Which connected camera is which of the rig: the cameras file, by port or by serial number."""

from __future__ import annotations

import collections
import dataclasses
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from lightstage.cameras.camera import VERIFIABLE, CameraDevice, Summary
from lightstage.cameras.process import CameraProcess, Deadlines
from lightstage.errors import ConfigError, DeviceError, LightstageError, one_error
from lightstage.formats.config import make_config, read_toml
from lightstage.rig import Camera, Rig

DRIVER = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")
"""A driver's place: a module's dotted name, a colon, a name in it."""


@dataclasses.dataclass(frozen=True)
class CameraEntry:
    """Where one camera is; without a port it is found by the serial number in rig.json.

    Attributes:
        port: libgphoto2's name, such as ``usb:001,004``; what the driver calls it where one is
            named.
        virtual_folder: folder of libgphoto2's virtual camera.
        driver: ``package.module:name``, called with the port, of a camera that is not
            libgphoto2's.
        expect: what this camera must tell, by Summary's names, over what all must.
    """

    port: str | None = None
    virtual_folder: Path | None = None
    driver: str | None = None
    expect: dict[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class CamerasFile:
    """The cameras file.

    Attributes:
        allow_unverifiable: names of what a camera may be unable to tell (of VERIFIABLE).
        expect: what every camera must tell, by Summary's names.
        cameras: camera id to where it is.
    """

    allow_unverifiable: tuple[str, ...] = ()
    expect: dict[str, str] = dataclasses.field(default_factory=dict)
    cameras: dict[str, CameraEntry] = dataclasses.field(default_factory=dict)


def read_cameras_file(path: Path) -> CamerasFile:
    """Read a cameras file (TOML); ConfigError on an unknown key or name."""
    values = read_toml(path)
    file = make_config(CamerasFile, values, path)
    for name in file.allow_unverifiable:
        if name not in VERIFIABLE:
            raise ConfigError(
                path,
                field="allow_unverifiable",
                found=repr(name),
                expected=f"of {', '.join(VERIFIABLE)}",
            )
    entries = {}
    for camera_id, value in values.get("cameras", {}).items():
        where = f"{path}, [cameras.{camera_id}]"
        if not isinstance(value, dict):
            raise ConfigError(where, found=repr(value), expected="a table with port = ..")
        entry = make_config(CameraEntry, value, where)
        if entry.virtual_folder is not None:
            folder = path.parent / entry.virtual_folder.expanduser()
            entry = dataclasses.replace(entry, virtual_folder=folder.absolute())
        if entry.driver is not None and not DRIVER.fullmatch(entry.driver):
            raise ConfigError(
                where, field="driver", found=repr(entry.driver), expected="package.module:name"
            )
        entries[camera_id] = entry
    return dataclasses.replace(file, cameras=entries)


def binding_problems(rig: Rig, file: CamerasFile) -> list[LightstageError]:
    """What is wrong with a cameras file before any camera is asked."""
    problems: list[LightstageError] = []
    known = [camera.id for camera in rig.cameras]
    for camera_id, entry in file.cameras.items():
        if camera_id not in known:
            problems.append(
                DeviceError(
                    f"camera {camera_id}",
                    found="an entry in the cameras file, none in the rig",
                    expected=f"one of {', '.join(known)}",
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
    cameras: Sequence[Camera], told: Sequence[Summary], allow_unverifiable: Sequence[str]
) -> list[LightstageError]:
    """Where cameras contradict the rig or each other, or cannot tell what is not allowed.

    Args:
        cameras: the rig's, in the order of `told`.
        told: what the devices tell.
        allow_unverifiable: names that a camera may be unable to tell.
    """
    problems: list[LightstageError] = []
    for camera, summary in zip(cameras, told, strict=True):
        for name, wanted in (("serial", camera.serial), ("model", camera.model)):
            found = getattr(summary, name)
            if found is not None and found != wanted:
                problems.append(
                    DeviceError(
                        f"camera {camera.id}",
                        field=name,
                        found=found,
                        expected=f"{wanted} (rig.json)",
                        hint="Is another camera at this port?",
                    )
                )
        refused = [name for name in summary.untold() if name not in allow_unverifiable]
        if refused:
            problems.append(
                DeviceError(
                    f"camera {camera.id}",
                    field=", ".join(refused),
                    found="not verifiable: the camera cannot tell",
                    expected="a camera that tells, or the name in allow_unverifiable",
                    hint="Allow it in the cameras file if you made sure by eye.",
                )
            )
    serials = collections.Counter(s.serial for s in told if s.serial is not None)
    for serial, count in serials.items():
        if count > 1:
            ids = [c.id for c, s in zip(cameras, told, strict=True) if s.serial == serial]
            problems.append(
                DeviceError(
                    f"cameras {', '.join(ids)}",
                    field="serial",
                    found=f"{serial} for all of them",
                    expected="one camera each",
                )
            )
    return problems


def bind_by_serial(
    wanted: Sequence[Camera], candidates: Sequence[tuple[str, Summary]]
) -> tuple[dict[str, str], list[LightstageError]]:
    """Match cameras to ports by serial number.

    Args:
        wanted: cameras of the rig without a port.
        candidates: port and what the camera there tells.

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
                found=serial or "a camera that cannot tell it",
                expected="a serial number of rig.json",
                hint="Add the camera to the rig, unplug it, or give its port in the cameras file.",
            )
        )
    return bound, problems


def find_cameras(
    rig: Rig,
    file: CamerasFile,
    deadline_s: Deadlines | float,
    detect: Callable[[float], list[tuple[str, str]]],
    make: Callable[
        [str, str, Path | None, Deadlines | float, str | None], CameraProcess
    ] = CameraProcess,
) -> list[CameraProcess]:
    """One process for each camera of the rig, in the rig's order, not yet open.

    Args:
        rig: the cameras wanted.
        file: what is known of where they are.
        deadline_s: of the cameras' commands; one number for all of them.
        detect: lists model and port of connected cameras; asked only where a port is missing.
        make: builds a camera from id, port, virtual folder, deadline, driver.

    Raises:
        DeviceError: every missing, unknown or doubled camera, in one message.
    """
    problems = binding_problems(rig, file)
    if problems:
        raise one_error(problems)
    entries = {camera.id: file.cameras.get(camera.id, CameraEntry()) for camera in rig.cameras}
    searched = [camera for camera in rig.cameras if entries[camera.id].port is None]
    if searched:
        open_s = deadline_s.open_s if isinstance(deadline_s, Deadlines) else deadline_s
        taken = {entry.port for entry in entries.values()}
        free = [port for _, port in detect(open_s) if port not in taken]
        probes = [make(f"at {port}", port, None, deadline_s, None) for port in free]
        told, problems = open_cameras(probes)
        close_cameras(probes)
        if not problems:
            bound, problems = bind_by_serial(searched, list(zip(free, told, strict=True)))
        if problems:
            raise one_error(problems)
        entries |= {camera_id: CameraEntry(port) for camera_id, port in bound.items()}
    return [
        make(camera_id, entry.port or "", entry.virtual_folder, deadline_s, entry.driver)
        for camera_id, entry in entries.items()
    ]


def open_cameras(
    cameras: Sequence[CameraDevice],
) -> tuple[list[Summary], list[LightstageError]]:
    """Open cameras, all at once; the summaries, or the errors of all that failed."""

    def attempt(camera: CameraDevice) -> Summary | LightstageError:
        try:
            return camera.open()
        except LightstageError as error:
            return error

    if not cameras:
        return [], []
    with ThreadPoolExecutor(len(cameras)) as pool:
        results = list(pool.map(attempt, cameras))
    problems = [result for result in results if isinstance(result, LightstageError)]
    return [result for result in results if isinstance(result, Summary)], problems


def close_cameras(cameras: Sequence[CameraDevice]) -> None:
    """Close cameras, all at once."""
    if cameras:
        with ThreadPoolExecutor(len(cameras)) as pool:
            list(pool.map(lambda camera: camera.close(), cameras))
