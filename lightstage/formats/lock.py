"""A folder with one writer at a time."""

from __future__ import annotations

import contextlib
import fcntl
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
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        until = time.monotonic() + wait_s
        try:
            while True:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() >= until:
                        raise busy from None
                    time.sleep(LOOK_AGAIN_S)
        except OSError as error:
            raise DiskError(
                path,
                found=f"a disk that cannot lock a file ({error.strerror})",
                expected="one that can, so that two runs cannot write one folder",
                hint="Choose a folder on another disk.",
            ) from None
        yield
