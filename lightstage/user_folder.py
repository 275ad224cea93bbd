"""The folder of the system's temporary folder that holds what running programs of a user share."""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from pathlib import Path


def user_folder() -> Path:
    """Where it is; it need not exist, and a folder of this name may be somebody else's."""
    return Path(tempfile.gettempdir()) / f"lightstage-{os.getuid()}"


def own_folder(folder: Path) -> bool:
    """Make a folder if it is not there; whether it is a real one that nobody else gets into."""
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700)
    try:
        about = os.lstat(folder)
    except OSError:
        return False
    alone = about.st_uid == os.getuid() and not about.st_mode & 0o077
    return stat.S_ISDIR(about.st_mode) and alone and os.access(folder, os.W_OK | os.X_OK)
