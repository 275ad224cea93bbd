"""A folder with one writer at a time."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Iterator
from pathlib import Path

from lightstage.errors import DiskError, LightstageError

LOOK_AGAIN_S = 0.02


@contextlib.contextmanager
def locked(path: Path, busy: LightstageError, wait_s: float = 0.0) -> Iterator[None]:
    """Hold a lock file until the block, or the process, ends; the empty file stays.

    Removing it would let two in: one that has the removed file locked, one that makes a new one.

    Args:
        path: the file; its folder is made where there is none.
        busy: raised where another process holds it.
        wait_s: so long, before that.

    Raises:
        DiskError: a disk that cannot lock files.
    """
    until = time.monotonic() + wait_s
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() >= until:
                    raise busy from None
            except OSError as error:
                raise DiskError(
                    path,
                    found=f"a disk that cannot lock a file ({error.strerror})",
                    expected="one that can, so that two runs cannot write one folder",
                    hint="Choose a folder on another disk.",
                ) from None
            else:
                if _is_at(file.fileno(), path):
                    yield
                    return
                # The folder was replaced as a whole meanwhile, and its lock with it.
                continue
        time.sleep(LOOK_AGAIN_S)


def _is_at(handle: int, path: Path) -> bool:
    """Whether an open file or folder is still the one at `path`."""
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    return os.path.samestat(os.fstat(handle), there)
