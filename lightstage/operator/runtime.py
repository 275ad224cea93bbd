"""The folder of the sockets of running captures: of this user alone."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import socket
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from lightstage.errors import CaptureError

LONGEST_BYTES = 100
"""A unix socket's address holds 108 bytes, on some systems 104."""


def new_socket_path() -> Path:
    """A free name for this process's socket; sockets of dead captures are removed on the way.

    Raises:
        CaptureError: no folder that is short enough and this user's alone.
    """
    name = f"{os.getpid()}-{secrets.token_hex(4)}.sock"
    for folder in _folders():
        if len(os.fsencode(folder / name)) <= LONGEST_BYTES and _own(folder):
            remove_stale(folder)
            return folder / name
    raise CaptureError(
        "the events' socket",
        found="no folder with a short name that is this user's alone",
        expected="one of " + ", ".join(map(str, _folders())),
        hint="Set XDG_RUNTIME_DIR to such a folder.",
    )


def remove_stale(folder: Path) -> list[Path]:
    """Remove sockets whose process has ended and where nobody answers; returns them."""
    removed = []
    for path in sorted(folder.glob("*.sock")):
        match = re.fullmatch(r"(\d+)-[0-9a-f]+\.sock", path.name)
        if match and not _lives(int(match[1])) and not socket_answers(path):
            path.unlink(missing_ok=True)
            removed.append(path)
    return removed


def _folders() -> Iterator[Path]:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_absolute():
        yield Path(runtime) / "lightstage"
    yield Path(tempfile.gettempdir()) / f"lightstage-{os.getuid()}"
    yield Path("/tmp") / f"lightstage-{os.getuid()}"


def _own(folder: Path) -> bool:
    """Make the folder if it is not there; whether it is a real one that nobody else gets into."""
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700)
    try:
        about = os.lstat(folder)
    except OSError:
        return False
    alone = about.st_uid == os.getuid() and not about.st_mode & 0o077
    return stat.S_ISDIR(about.st_mode) and alone and os.access(folder, os.W_OK | os.X_OK)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def socket_answers(path: Path) -> bool:
    """Whether a process takes connections at a socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError:
            return True
    return True
