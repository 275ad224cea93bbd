"""Whether the session's disk and the cameras' cards take the whole plan."""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path

from lightstage.cameras.camera import FREE_CARD, Summary
from lightstage.counting import counted
from lightstage.findings import Finding
from lightstage.preflight.config import Plan, PreflightConfig
from lightstage.rig import Camera, Rig
from lightstage.session.disk import rename_new

BYTES_PER_PIXEL = 2.0
"""Bytes a pixel of a RAW that is not compressed: 14 or 16 bits, previews on top of packed ones."""
HEADER_BYTES = 1 << 20
LONGEST_TAKE = ".take99.partial"


def photograph_bytes(camera: Camera, plan: Plan) -> int:
    """Size of one photograph: the plan's, or a guess from the camera's pixels."""
    if plan.bytes_per_photograph is not None:
        return plan.bytes_per_photograph
    return round(camera.width_px * camera.height_px * BYTES_PER_PIXEL) + HEADER_BYTES


def card_findings(
    rig: Rig, summaries: Mapping[str, Summary], plan: Plan, config: PreflightConfig
) -> list[Finding]:
    """Cards that do not hold what is still to be taken (photographs stay on them)."""
    findings = []
    for camera_id, summary in summaries.items():
        one = photograph_bytes(rig.camera(camera_id), plan)
        wanted = plan.photographs_per_camera * one * (1 + config.space_margin)
        free = summary.card_free_bytes
        if free is not None and free < wanted:
            findings.append(
                Finding(
                    "refuse",
                    "card-space",
                    f"camera {camera_id}, card",
                    f"{_size(free)} free",
                    f"{_size(wanted)} for {counted(plan.photographs_per_camera, 'photograph')}",
                    FREE_CARD,
                    camera=camera_id,
                )
            )
    return findings


def disk_findings(rig: Rig, out: Path, plan: Plan, config: PreflightConfig) -> list[Finding]:
    """Space, and whether files can be made, flushed and named as a session needs it.

    Tried in a folder of its own, which is removed, in the session's folder or the nearest one above
    it that exists.

    Args:
        rig: its cameras take the photographs.
        out: the session's folder, which may not exist yet.
        plan: what is to be taken.
        config: the margin.
    """
    there = out.absolute()
    while not os.path.isdir(there) and there != there.parent:  # no name is too long for it
        there = there.parent
    blocking = next(iter(out.absolute().relative_to(there).parts), None)
    if blocking is not None and os.path.lexists(there / blocking):
        return [_unusable(there / blocking, NotADirectoryError("a file, not a folder"))]
    findings = _space(rig, there, plan, config)
    findings += _names(rig, out.absolute(), there, plan)
    findings += _trial(rig, there, plan)
    return findings


def _space(rig: Rig, there: Path, plan: Plan, config: PreflightConfig) -> list[Finding]:
    photographs = plan.photographs_per_camera * sum(
        photograph_bytes(camera, plan) for camera in rig.cameras
    )
    wanted = photographs * (1 + config.space_margin)
    try:
        disk = os.statvfs(there)
    except OSError as error:
        return [_unusable(there, error)]
    free = disk.f_bavail * disk.f_frsize
    findings = []
    if free < wanted:
        findings.append(
            Finding(
                "refuse",
                "disk-space",
                f"disk of {there}",
                f"{_size(free)} free",
                f"{_size(wanted)} for the whole capture",
                "Make room, or give an --out on another disk.",
            )
        )
    files = 2 * plan.photographs_per_camera * len(rig.cameras) + 100
    if disk.f_files and disk.f_favail < files:  # some file systems do not count them
        findings.append(
            Finding(
                "refuse",
                "disk-space",
                f"disk of {there}",
                f"{counted(disk.f_favail, 'file')} free",
                f"{files} for the whole capture",
                "Remove small files, or give an --out on another disk.",
            )
        )
    return findings


def _longest_names(rig: Rig, plan: Plan) -> tuple[str, str]:
    """The longest folder and file name of the session's photographs."""
    folder = max(plan.patterns, key=_length, default="full")
    camera = max((camera.id for camera in rig.cameras), key=_length, default="cam0")
    return folder, f".{camera}{LONGEST_TAKE}"


def _length(name: str | Path) -> int:
    """Bytes that a name takes on the disk."""
    return len(os.fsencode(name))


def _names(rig: Rig, out: Path, there: Path, plan: Plan) -> list[Finding]:
    findings = []
    folder, file = _longest_names(rig, plan)
    try:
        name_max = os.pathconf(there, "PC_NAME_MAX")
        path_max = os.pathconf(there, "PC_PATH_MAX")
    except (OSError, ValueError):
        return []  # what the file system takes is tried too
    parts = [*out.parts[len(there.parts) :], folder, file]
    longest = max(map(_length, parts))
    whole = _length(out / "frames" / folder / file)
    for found, most, what in ((longest, name_max, "a name"), (whole + 1, path_max, "a path")):
        if found > most:
            findings.append(
                Finding(
                    "refuse",
                    "path-length",
                    f"{there}, session",
                    f"{what} of {counted(found, 'byte')}",
                    f"at most {most}",
                    "Give a shorter --out, or shorter names of cameras and patterns.",
                )
            )
    return findings


def _trial(rig: Rig, there: Path, plan: Plan) -> list[Finding]:
    """Do once what every photograph needs."""
    trial = there / f".preflight-{secrets.token_hex(4)}"
    folder, file = _longest_names(rig, plan)
    try:
        trial.mkdir()
    except OSError as error:
        return [_unusable(there, error)]
    try:
        inner = trial / folder
        inner.mkdir()
        partial, named = inner / file, inner / "photograph"
        with partial.open("xb") as handle:
            handle.write(b"trial")
            handle.flush()
            os.fsync(handle.fileno())
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        rename_new(partial, named)
        partial.write_bytes(b"another")
        if not _refuses_second(partial, named):
            raise OSError("a file can be named over another one")
        folder_handle = os.open(inner, os.O_RDONLY)
        try:
            os.fsync(folder_handle)
        finally:
            os.close(folder_handle)
        if named.read_bytes() != b"trial":
            raise OSError("a file reads back differently")
        return _folded(rig, trial)
    except OSError as error:
        return [_unusable(there, error)]
    finally:
        shutil.rmtree(trial, ignore_errors=True)


def _refuses_second(partial: Path, named: Path) -> bool:
    try:
        rename_new(partial, named)
    except FileExistsError:
        return True
    return False


def _folded(rig: Rig, trial: Path) -> list[Finding]:
    """Cameras whose names are one on a file system that does not distinguish letters' case."""
    for camera in rig.cameras:
        try:
            (trial / camera.id).mkdir()
        except FileExistsError:
            return [
                Finding(
                    "refuse",
                    "names",
                    f"{trial.parent}, camera {camera.id}",
                    "a file system on which two cameras' names are the same",
                    "one that distinguishes upper from lower case",
                    "Give an --out on another disk, or rename the cameras in rig.json.",
                )
            ]
    return []


def _unusable(there: Path, error: OSError) -> Finding:
    return Finding(
        "refuse",
        "disk",
        f"folder {there}",
        error.strerror or str(error),
        "a folder in which files can be written, flushed, named and locked",
        "Give an --out on a local disk that you may write to.",
    )


def _size(count: float) -> str:
    for unit, weight in (("GB", 1e9), ("MB", 1e6)):
        if count >= weight:
            return f"{count / weight:.1f} {unit}"
    return f"{count / 1e3:.0f} kB"
