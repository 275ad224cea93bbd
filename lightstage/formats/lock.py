"""A folder with one writer at a time, and folders whose writer was killed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import time
from collections.abc import Callable, Iterator
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
        DiskError: a disk that cannot lock files, or a folder that was removed meanwhile.
    """
    until = time.monotonic() + wait_s
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        try:
            file = path.open("a")
        except FileNotFoundError:
            if time.monotonic() < until:
                # It is away for a moment where another takes its place.
                time.sleep(LOOK_AGAIN_S)
                continue
            raise DiskError(
                path.parent,
                found="a folder that another process removed meanwhile",
                expected="one that stays",
                hint="Call the command again.",
            ) from None
        with file:
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


@contextlib.contextmanager
def being_filled(name: Callable[[], Path]) -> Iterator[Path]:
    """Make a folder, and mark it as one that somebody fills until the block, or the process, ends.

    Where the disk cannot lock, it is not marked, and nobody finds it abandoned either.

    Args:
        name: gives a new name at each call.
    """
    while True:
        folder = name()
        folder.mkdir()
        handle = -1
        try:
            handle = os.open(folder, os.O_RDONLY)
            with contextlib.suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_SH)
            if not _is_at(handle, folder):
                continue  # somebody found it before it was marked, and removed it
            yield folder
            return
        except FileNotFoundError:
            if handle >= 0:
                raise
        finally:
            if handle >= 0:
                os.close(handle)


def abandoned(folder: Path) -> bool:
    """Whether a folder is there that `being_filled` made and nobody fills any more."""
    return _if_abandoned(folder, lambda: None)


def remove_abandoned(folder: Path) -> bool:
    """Remove a folder that nobody fills any more; returns whether that was so."""
    return _if_abandoned(folder, lambda: shutil.rmtree(folder))


def _if_abandoned(folder: Path, act: Callable[[], None]) -> bool:
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    else:
        act()
        return True
    finally:
        os.close(handle)


def _is_at(handle: int, path: Path) -> bool:
    """Whether an open file or folder is still the one at `path`."""
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    return os.path.samestat(os.fstat(handle), there)
