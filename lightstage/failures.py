"""What the system and its libraries raise, in this project's words.

A full disk is one error to a user, but Python raises OSError for it, OpenEXR a RuntimeError and
safetensors an error of its own; OpenCV returns False. Here each becomes one clear error.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

from lightstage.counting import counted
from lightstage.errors import DiskError, DiskFullError, LightstageError, MemoryLimitError

_FULL = {errno.ENOSPC, errno.EDQUOT}
_FULL_TEXTS = ("no space left on device", "disk quota exceeded")
_MEMORY_TEXTS = (
    "can't allocate memory",
    "not enough memory",
    "insufficient memory",  # OpenCV
    "out of memory",
    "std::bad_alloc",
)
_CODECS = ("safetensors", "safetensors_rust", "cv2", "rawpy", "OpenEXR", "zarr", "zlib", "PIL")
"""Modules whose own errors are of a file that they cannot read or write."""
_OF_FILES = "imgcodecs"
"""The part of OpenCV that reads and writes files; errors of its others are defects of ours."""
_MEANINGS = {
    errno.EACCES: ("no permission", "a place that you may read and write"),
    errno.EPERM: ("no permission", "a place that you may read and write"),
    errno.EROFS: ("a read-only disk", "a place that can be written"),
    errno.ENOTDIR: ("a file where a folder is needed", "folders alone before the last name"),
    errno.EISDIR: ("a folder", "a file"),
    errno.EEXIST: ("something that exists already", "a new name"),
    errno.ENOENT: ("nothing of this name", "an existing file or folder"),
    errno.ENAMETOOLONG: ("a name that is too long for this disk", "at most 255 bytes a name"),
    errno.ELOOP: ("links that lead in a circle", "a path without such links"),
    errno.ENOTEMPTY: ("a folder that holds something", "an empty or a new folder"),
    errno.EMFILE: ("too many open files", "a higher limit (`ulimit -n`)"),
    errno.EIO: ("a disk that does not answer (input/output error)", "a disk that works"),
}


def explain(error: BaseException) -> LightstageError | None:
    """The error that a user can mend behind an exception; None where it is a defect of ours.

    Args:
        error: what was raised; a LightstageError is returned as it is.
    """
    if isinstance(error, LightstageError):
        return error
    if is_disk_full(error):
        name = getattr(error, "filename", None)
        return disk_full(Path(os.fsdecode(name)) if name else Path.cwd())
    if isinstance(error, MemoryError) or _has_text(error, _MEMORY_TEXTS):
        return MemoryLimitError(
            "memory",
            found=_one_line(error),
            expected="work that fits into this machine's memory",
            hint="Close other programs, or ask for smaller maps, fewer rows or a smaller tile.",
        )
    if isinstance(error, OSError):
        return _system_error(error)
    if isinstance(error, RuntimeError) and "cannot cache function" in str(error):
        return DiskError(
            "compiled code",
            found="no folder that numba can write to",
            expected="a folder to keep compiled code in",
            hint="Set NUMBA_CACHE_DIR to one.",
        )
    module = type(error).__module__.split(".")[0].lstrip("_")
    if module in _CODECS and (module != "cv2" or _OF_FILES in str(error)):
        found = _one_line(error)
        return DiskError(module, found=found, expected="a file that it can read or write")
    return None


def is_disk_full(error: BaseException) -> bool:
    """Whether an exception of any library means that the disk is full."""
    if isinstance(error, DiskFullError):
        return True
    if isinstance(error, OSError) and error.errno in _FULL:
        return True
    return _has_text(error, _FULL_TEXTS)


def disk_full(path: Path, written: int = 0, needed: int | None = None) -> DiskFullError:
    """The error of a full disk, with what is missing as far as it is known.

    Args:
        path: what was being written.
        written: bytes of it that were on the disk when it was full; they are removed by now.
        needed: bytes of the whole, where that is known.
    """
    free = free_bytes(path)
    if needed is not None:
        expected = f"{_size(needed)}: {_size(max(needed - free, 0))} more"
    elif written:
        expected = f"more than the {_size(written)} that had been written when it was full"
    else:
        expected = "more room"
    error = DiskFullError(
        path,
        found=f"a full disk, {_size(free)} free",
        expected=expected,
        hint="Free some space, or name an output on another disk. Nothing was left half-written.",
    )
    error.written = written
    return error


def free_bytes(path: Path) -> int:
    """Bytes that this user may still write where `path` is, or would be."""
    there = nearest_existing(path)
    disk = os.statvfs(there)
    return disk.f_bavail * disk.f_frsize


def nearest_existing(path: Path) -> Path:
    """`path`, or the nearest folder above it that exists."""
    there = path.absolute()
    while not os.path.lexists(there) and there != there.parent:
        there = there.parent
    return there


def _system_error(error: OSError) -> LightstageError:
    names = [
        os.fsdecode(n) for n in (error.filename, error.filename2) if isinstance(n, str | bytes)
    ]
    where = " -> ".join(names) or "the system"
    reason = error.strerror or _one_line(error)
    if error.errno not in _MEANINGS:
        return DiskError(where, found=reason)
    found, expected = _MEANINGS[error.errno]
    return DiskError(where, found=found, expected=expected)


def _has_text(error: BaseException, texts: tuple[str, ...]) -> bool:
    """Whether an exception of a library that has no class of its own for it has one of `texts`."""
    message = str(error).lower()
    return isinstance(error, Exception) and any(text in message for text in texts)


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text[:200] or type(error).__name__


def _size(count: int) -> str:
    """Bytes, readable."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return counted(count, "byte")
