"""A photograph's way from its temporary file to its name, each step on the disk before the next."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from pathlib import Path

from lightstage.counting import counted
from lightstage.errors import CaptureError, CutPhotographError, FormatError
from lightstage.formats.files import fsync_path
from lightstage.photo_file import Kind, identify_file
from lightstage.session.disk import disk_errors, rename_new
from lightstage.steps import step

CHUNK_BYTES = 1 << 18


@dataclasses.dataclass(frozen=True)
class Arrival:
    """A downloaded file that shall get its name.

    Attributes:
        path: temporary, in the folder of its final name.
        stem: final name without suffix.
        size: bytes, as the camera reports it.
        sha256: of the bytes where they left the camera's driver.
        where: what to call it in errors.
        pattern: whose photograph.
        camera: whose photograph.
    """

    path: Path
    stem: str
    size: int
    sha256: str
    where: str
    pattern: str
    camera: str


def settle(arrival: Arrival) -> tuple[Path, Kind]:
    """Verify a downloaded file on the disk, and give it its name.

    Size, header and hash are those of bytes read back from the disk, not from the computer's
    memory. Nothing larger than CHUNK_BYTES is held. The name never takes another file's place.

    Returns:
        Where it is now, and what it is. The folder is flushed; no journal knows it yet.

    Raises:
        CutPhotographError: another size or hash.
        CaptureError: a name that is taken, or the disk refuses.
        FormatError: no photograph, or a truncated one.
        In all these cases the file stays under its temporary name.
    """
    where, at = arrival.where, (arrival.pattern, arrival.camera)
    with disk_errors(arrival.path):
        handle = os.open(arrival.path, os.O_RDONLY)
    try:
        with disk_errors(arrival.path):
            forget_cache(handle)
            size = os.fstat(handle).st_size
        if size != arrival.size:
            raise CutPhotographError(
                where,
                field="size",
                found=f"{counted(size, 'byte')} on the disk",
                expected=f"{arrival.size} as the camera reports",
                hint="The photograph is still on the camera.",
            )
        step("sized", *at)
        with disk_errors(arrival.path):
            kind = identify_file(arrival.path, where)
        step("parsed", *at)
        with disk_errors(arrival.path):
            found = _sha256(handle)
        if found != arrival.sha256:
            raise CutPhotographError(
                where,
                field="sha256",
                found=f"{found[:12]}.. on the disk",
                expected=f"{arrival.sha256[:12]}.. as the camera gave it",
                hint="Check the disk; the photograph is still on the camera.",
            )
        step("hashed", *at)
        with disk_errors(arrival.path):
            os.fsync(handle)
        step("flushed", *at)
    finally:
        os.close(handle)
    path = arrival.path.with_name(arrival.stem + kind.suffix)
    with disk_errors(path):
        try:
            rename_new(arrival.path, path)
        except FileExistsError:
            raise CaptureError(
                path, found="a photograph of this name", expected="none yet"
            ) from None
    step("named", *at)
    with disk_errors(path):
        fsync_path(path.parent)
    step("folder-flushed", *at)
    return path, kind


def is_whole(path: Path, size: int) -> bool:
    """Whether a file has this size and a photograph's header, and is as long as by that."""
    try:
        if path.stat().st_size != size:
            return False
        identify_file(path)
    except (OSError, FormatError):
        return False
    return True


def sha256_on_disk(path: Path) -> str:
    """SHA-256 of what the disk (not the computer's memory) holds of a file, in hexadecimal."""
    handle = os.open(path, os.O_RDONLY)
    try:
        forget_cache(handle)
        return _sha256(handle)
    finally:
        os.close(handle)


def forget_cache(handle: int) -> None:
    """Flush a file and let the system forget its copy in memory, so that reading asks the disk."""
    os.fsync(handle)
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)


def _sha256(handle: int) -> str:
    digest, done = hashlib.sha256(), 0
    while chunk := os.pread(handle, CHUNK_BYTES, done):
        digest.update(chunk)
        done += len(chunk)
    return digest.hexdigest()
