"""A folder with one writer at a time."""

from __future__ import annotations

import contextlib
import fcntl
from collections.abc import Iterator
from pathlib import Path

from lightstage.errors import DiskError, LightstageError


@contextlib.contextmanager
def locked(path: Path, busy: LightstageError) -> Iterator[None]:
    """Hold a lock file until the block, or the process, ends; the empty file stays.

    Removing it would let two in: one that has the removed file locked, one that makes a new one.

    Args:
        path: the file; its folder is made where there is none.
        busy: raised where another process holds it.

    Raises:
        DiskError: a disk that cannot lock files.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise busy from None
        except OSError as error:
            raise DiskError(
                path,
                found=f"a disk that cannot lock a file ({error.strerror})",
                expected="one that can, so that two runs cannot write one folder",
                hint="Choose a folder on another disk.",
            ) from None
        yield
