"""A card's file on its way to the disk: in pieces, hashed as it comes, flushed, never over another.

Runs in a camera's own process; any driver's `download` may use it.
"""

from __future__ import annotations

import contextlib
import contextvars
import errno
import hashlib
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from lightstage import steps
from lightstage.cameras.camera import Download
from lightstage.errors import CaptureError

PIECE_BYTES = 1 << 20
SHOT: contextvars.ContextVar[tuple[str, str]] = contextvars.ContextVar("SHOT", default=("*", "*"))
"""Pattern and camera whose photograph it is, as the worker received them: for the step's name."""
HINTS = {
    errno.ENOSPC: "The disk is full: free some room, then take the photograph again.",
    errno.EDQUOT: "Your share of the disk is used up: free some room, then continue.",
    errno.EFBIG: "The disk or this user's limits take no file of this size.",
    errno.EROFS: "The disk cannot be written to: was it mounted again after an error?",
    errno.EACCES: "This user may not write there.",
    errno.EPERM: "This user may not write there.",
    errno.ENOENT: "The folder is gone: was it removed, or its disk taken away?",
    errno.ENOTDIR: "The folder is gone: a file has its name.",
    errno.EEXIST: "Nothing is overwritten: that file belongs to another photograph.",
    errno.EIO: "The disk fails: use another one.",
}
"""What to try, by the system's error."""


def pieces(data: memoryview) -> Iterator[memoryview]:
    """A file's bytes in two pieces or more, none over PIECE_BYTES; no copy is made."""
    step = max(1, min(PIECE_BYTES, -(-len(data) // 2)))
    return (data[start : start + step] for start in range(0, len(data), step))


def write_card_file(path: Path, size: int, source: Iterable[bytes | memoryview]) -> Download:
    """Write what a driver gives to a new file, and flush it to the disk.

    The step ``downloading`` is where half of `size` is written. What is there of the file when
    anything fails is removed, so that it can be asked for again.

    Args:
        path: which must not exist; its folder must.
        size: bytes, as the camera reports it; what comes may be less or more, and is reported.
        source: the bytes in order; what it raises passes.

    Returns:
        Size and SHA-256 of what `source` gave, hashed before it was written.

    Raises:
        CaptureError: the disk is full, gone, read-only, or `path` is taken.
    """
    started_s = time.monotonic()
    digest = hashlib.sha256()
    written, halved = 0, False
    with _disk(path, size):
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    whole = False
    try:
        for piece in source:
            digest.update(piece)
            left = memoryview(piece)
            while len(left):
                with _disk(path, size):
                    count = os.write(handle, left)
                left, written = left[count:], written + count
            if not halved and 2 * written >= size:
                halved = True
                steps.step("downloading", *SHOT.get())
        with _disk(path, size):
            os.fsync(handle)
        whole = True
    finally:
        os.close(handle)
        if not whole:
            with contextlib.suppress(OSError):
                path.unlink()
    return Download(written, digest.hexdigest(), time.monotonic() - started_s)


@contextlib.contextmanager
def _disk(path: Path, size: int) -> Iterator[None]:
    """The disk's error in plain words."""
    try:
        yield
    except OSError as error:
        raise CaptureError(
            path,
            field="write",
            found=error.strerror or str(error),
            expected=f"room for a new file of {size} bytes",
            hint=HINTS.get(error.errno or 0, "Is the disk still there, and whole?"),
        ) from None
