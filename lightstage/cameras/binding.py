"""Which connected camera is which of the rig: by port or by serial number, never by guess.

Names of cameras_file and identity can be had from here too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from lightstage.cameras.camera import CameraDevice, Summary
from lightstage.cameras.cameras_file import CameraEntry as CameraEntry
from lightstage.cameras.cameras_file import CamerasFile as CamerasFile
from lightstage.cameras.cameras_file import read_cameras_file as read_cameras_file
from lightstage.cameras.identity import bind_by_serial as bind_by_serial
from lightstage.cameras.identity import binding_problems as binding_problems
from lightstage.cameras.identity import summary_problems as summary_problems
from lightstage.cameras.process import CameraProcess, Deadlines
from lightstage.errors import LightstageError, one_error
from lightstage.rig import Camera, Rig


@dataclasses.dataclass(frozen=True)
class Moved:
    """A camera that was found at another port than it was searched for at.

    Attributes:
        camera: its id.
        serial: its serial number, by which it was found.
        port: where it was searched for.
        there: serial number of the body that is there instead; None where nothing answered.
        found: the port at which it is.
    """

    camera: str
    serial: str
    port: str
    there: str | None
    found: str


Make = Callable[[str, str, Path | None, Deadlines | float, str | None], CameraProcess]
"""Builds a camera from id, port, virtual folder, deadlines, driver."""


def find_cameras(
    rig: Rig,
    file: CamerasFile,
    deadline_s: Deadlines | float,
    detect: Callable[[float], list[tuple[str, str]]],
    make: Make = CameraProcess,
) -> list[CameraProcess]:
    """One process for each camera of the rig, in the rig's order, not yet open.

    Args:
        rig: the cameras wanted.
        file: what is known of where they are.
        deadline_s: of the cameras' commands; one number for all of them.
        detect: lists model and port of connected cameras; asked only where a port is missing.
        make: builds a camera.

    Raises:
        DeviceError: every missing, unknown, doubled or swapped camera, in one message.
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
        summaries, problems = try_cameras(probes)
        close_cameras(probes)
        here = [(probe.port, summaries[probe.id]) for probe in probes if probe.id in summaries]
        bound, unbound = bind_by_serial(searched, here)
        problems += unbound
        if problems:
            # What is wrong with the cameras whose ports are given belongs to the same message.
            given = [camera for camera in rig.cameras if entries[camera.id].port is not None]
            made = [_made(make, c.id, entries[c.id], deadline_s) for c in given]
            problems += connect_problems(given, made, file.allow_unverifiable)[1]
            close_cameras(made)
            raise one_error(problems)
        entries |= {
            camera_id: dataclasses.replace(entries[camera_id], port=port)
            for camera_id, port in bound.items()
        }
    return [_made(make, *entry, deadline_s) for entry in entries.items()]


def connect_problems(
    wanted: Sequence[Camera],
    cameras: Sequence[CameraDevice],
    allow_unverifiable: Sequence[str],
    moved: list[Moved] | None = None,
) -> tuple[dict[str, Summary], list[LightstageError]]:
    """Open cameras, all at once, and check all that opened, also where others did not.

    Args:
        wanted: the rig's, in the order of `cameras`.
        cameras: not yet open.
        allow_unverifiable: names that a camera may be unable to report.
        moved: is given the cameras that were found at another port than their own; without it
            no other port is tried.

    Returns:
        What each camera reports, by its id, and every problem.
    """
    results = _attempts(cameras)
    if moved is not None:
        moved += _find_moved(wanted, cameras, results)
    summaries, problems = _parted(results)
    opened = [camera for camera in wanted if camera.id in summaries]
    problems += summary_problems(
        opened, [summaries[camera.id] for camera in opened], allow_unverifiable
    )
    return summaries, problems


def _made(
    make: Make, camera_id: str, entry: CameraEntry, deadline_s: Deadlines | float
) -> CameraProcess:
    return make(camera_id, entry.port or "", entry.virtual_folder, deadline_s, entry.driver)


def try_cameras(
    cameras: Sequence[CameraDevice],
) -> tuple[dict[str, Summary], list[LightstageError]]:
    """Open cameras, all at once; the summaries by id, and the errors of those that failed."""
    return _parted(_attempts(cameras))


def _attempts(cameras: Sequence[CameraDevice]) -> dict[str, Summary | LightstageError]:
    """Each camera's summary when it was opened, or why it was not, by its id."""

    def attempt(camera: CameraDevice) -> Summary | LightstageError:
        try:
            return camera.open()
        except LightstageError as error:
            return error

    if not cameras:
        return {}
    with ThreadPoolExecutor(len(cameras)) as pool:
        results = pool.map(attempt, cameras)
        return {camera.id: summary for camera, summary in zip(cameras, results, strict=True)}


def _parted(
    results: Mapping[str, Summary | LightstageError],
) -> tuple[dict[str, Summary], list[LightstageError]]:
    """The summaries by id, and the errors."""
    summaries = {name: result for name, result in results.items() if isinstance(result, Summary)}
    return summaries, [each for each in results.values() if isinstance(each, LightstageError)]


def _find_moved(
    wanted: Sequence[Camera],
    cameras: Sequence[CameraDevice],
    results: dict[str, Summary | LightstageError],
) -> list[Moved]:
    """Search the other ports for cameras that are not at their own; `results` is set right.

    One in whose place another camera of the rig is, is not searched for: `summary_problems` names
    it, since the bodies themselves may have been exchanged on the stage. One that is nowhere
    keeps its result.
    """
    own = {camera.serial for camera in wanted}
    lost = []
    for camera, device in zip(wanted, cameras, strict=True):
        result = results[camera.id]
        there = result.serial if isinstance(result, Summary) else None
        right = isinstance(result, Summary) and (there is None or there in own)
        # A virtual camera reports no serial number.
        if right or not isinstance(device, CameraProcess) or device.virtual_folder is not None:
            continue
        device.close()
        lost.append((camera, device, there))
    moved = []
    for camera, device, there in lost:
        port = device.port
        try:
            results[camera.id] = device.find(camera.serial)
        except LightstageError:
            continue
        if device.port != port:
            moved.append(Moved(camera.id, camera.serial, port, there, device.port))
    return moved


def close_cameras(cameras: Sequence[CameraDevice]) -> None:
    """Close cameras, all at once."""
    if cameras:
        with ThreadPoolExecutor(len(cameras)) as pool:
            list(pool.map(lambda camera: camera.close(), cameras))
