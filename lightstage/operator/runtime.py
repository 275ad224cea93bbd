"""The folder of the sockets of running captures: of this user alone."""

from __future__ import annotations

import os
import re
import secrets
import socket
from collections.abc import Iterator
from pathlib import Path

from lightstage.errors import CaptureError
from lightstage.user_folder import own_folder, user_folder

LONGEST_BYTES = 100
"""A unix socket's address holds 108 bytes, on some systems 104."""


def new_socket_path() -> Path:
    """A free name for this process's socket; sockets of dead captures are removed on the way.

    Raises:
        CaptureError: no folder that is short enough and this user's alone.
    """
    name = f"{os.getpid()}-{secrets.token_hex(4)}.sock"
    for folder in _folders():
        if len(os.fsencode(folder / name)) <= LONGEST_BYTES and own_folder(folder):
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
    yield user_folder()
    yield Path("/tmp") / user_folder().name


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
