"""Which connected camera is which of the rig: by port or by serial number, never by guess.

Names of cameras_file and identity can be had from here too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
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
        told, problems = try_cameras(probes)
        close_cameras(probes)
        here = [(probe.port, told[probe.id]) for probe in probes if probe.id in told]
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
    wanted: Sequence[Camera], cameras: Sequence[CameraDevice], allow_unverifiable: Sequence[str]
) -> tuple[dict[str, Summary], list[LightstageError]]:
    """Open cameras, all at once, and check all that opened, also where others did not.

    Args:
        wanted: the rig's, in the order of `cameras`.
        cameras: not yet open.
        allow_unverifiable: names that a camera may be unable to tell.

    Returns:
        What each camera tells, by its id, and every problem.
    """
    told, problems = try_cameras(cameras)
    opened = [camera for camera in wanted if camera.id in told]
    problems += summary_problems(opened, [told[camera.id] for camera in opened], allow_unverifiable)
    return told, problems


def _made(
    make: Make, camera_id: str, entry: CameraEntry, deadline_s: Deadlines | float
) -> CameraProcess:
    return make(camera_id, entry.port or "", entry.virtual_folder, deadline_s, entry.driver)


def try_cameras(
    cameras: Sequence[CameraDevice],
) -> tuple[dict[str, Summary], list[LightstageError]]:
    """Open cameras, all at once; the summaries by id, and the errors of those that failed."""

    def attempt(camera: CameraDevice) -> Summary | LightstageError:
        try:
            return camera.open()
        except LightstageError as error:
            return error

    if not cameras:
        return {}, []
    with ThreadPoolExecutor(len(cameras)) as pool:
        results = list(zip(cameras, pool.map(attempt, cameras), strict=True))
    problems = [result for _, result in results if isinstance(result, LightstageError)]
    return {c.id: told for c, told in results if isinstance(told, Summary)}, problems


def open_cameras(
    cameras: Sequence[CameraDevice],
) -> tuple[list[Summary], list[LightstageError]]:
    """Open cameras, all at once; the summaries, or the errors of all that failed."""
    told, problems = try_cameras(cameras)
    return list(told.values()), problems


def close_cameras(cameras: Sequence[CameraDevice]) -> None:
    """Close cameras, all at once."""
    if cameras:
        with ThreadPoolExecutor(len(cameras)) as pool:
            list(pool.map(lambda camera: camera.close(), cameras))
