"""What a disk refuses, in plain words."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from lightstage.errors import CaptureError
from lightstage.formats.files import fsync_path

_WORDS = {
    errno.ENOSPC: ("no space left on the disk", "Free some space, then resume."),
    errno.EDQUOT: ("no space left in this user's quota", "Free some space, then resume."),
    errno.EROFS: ("a disk that can only be read", "Mount it for writing, or give another folder."),
    errno.EACCES: ("no permission to write", "Change the folder's permissions, then resume."),
    errno.EPERM: ("no permission to write", "Change the folder's permissions, then resume."),
    errno.ENOENT: (
        "the file or its folder is gone",
        "Was the folder removed, renamed or unplugged? The photographs are still on the cameras.",
    ),
    errno.ENODEV: ("the disk is gone", "Was it unplugged? Connect it again, then resume."),
    errno.ENAMETOOLONG: (
        "File name too long",
        "Give a shorter name: most disks take up to 255 bytes for each folder of a path.",
    ),
    errno.ENOTDIR: ("a file where a folder must be", "Give another folder."),
    errno.ELOOP: ("links that lead back to themselves", "Give another folder."),
    errno.EFBIG: (
        "a file larger than this disk can hold",
        "Copy the folder to a disk that can hold it, then resume there.",
    ),
    errno.ESTALE: ("a network disk that is gone", "Connect it again, then resume."),
    errno.ENOTCONN: ("a network disk that is gone", "Connect it again, then resume."),
    errno.EIO: ("an error of the disk", "Copy what is there to another disk, then resume on it."),
    errno.EMFILE: ("too many open files", "Raise the limit of open files (ulimit -n)."),
}


@contextlib.contextmanager
def disk_errors(where: str | Path) -> Iterator[None]:
    """Turn the operating system's error for a file into a CaptureError that names `where`."""
    try:
        yield
    except OSError as error:
        usual = (str(error.strerror or error), "Inspect the disk and its mount, then resume.")
        found, hint = _WORDS.get(error.errno or 0, usual)
        raise CaptureError(
            where, found=found, expected="a disk that can be written", hint=hint
        ) from None


_NO_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EINVAL)
"""The errors of file systems without hard links (exFAT, some network shares)."""


def rename_new(source: Path, target: Path) -> None:
    """Give a file another name in the same file system, never in place of another file.

    A crash in between leaves the file under its old name, its new one, or both; where the file
    system has no hard links, at worst its old one beside an empty file of the new.

    Raises:
        FileExistsError: there is a file of that name.
        OSError: what else the disk refuses.
    """
    try:
        os.link(source, target)
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        # The name is taken first, by an empty file of our own; only that is then replaced.
        os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        os.replace(source, target)
        return
    os.unlink(source)


def make_folder(path: Path, top: Path) -> None:
    """Make a folder and its parents below `top`, so that they last through a loss of power.

    Args:
        path: inside `top`.
        top: a folder that is there; it is not made again where it was removed.
    """
    missing = [each for each in (path, *path.parents) if top in each.parents and not each.is_dir()]
    for folder in reversed(missing):
        with contextlib.suppress(FileExistsError):  # another camera's thread was first
            os.mkdir(folder)
        fsync_path(folder.parent)
