"""Where the tests' temporary files are: in memory, where it has room.

Captures and stores wait until a file is on the disk (fsync) before they count on it: two files of
tests do so two thousand times, for five milliseconds each. On a file system in memory the same
calls return at once, and what a killed process left is there as on a disk.
"""

from __future__ import annotations

import os
from pathlib import Path

MEMORY = Path("/dev/shm")
"""Where Linux has a file system in memory."""
TEMPORARY = "PYTEST_DEBUG_TEMPROOT"
"""The variable that names the folder of pytest's temporary folders; workers inherit it."""
FILES_BYTES = 2e9
"""Room that it must have: two workers' files took .3 GB at most."""
FREE_BYTES = 10e9
"""Memory that must be free: those files, and two workers of 3.5 GB with what they start."""
TABLES = Path("/proc")
"""Where Linux lists its mounts and its memory."""


def has_room(folder: Path) -> bool:
    """Whether a folder is one of memory that takes the tests' files and runs programs from it."""
    try:
        about = os.statvfs(folder)
        mounts = (TABLES / "mounts").read_text().splitlines()
        memory = (TABLES / "meminfo").read_text().splitlines()
    except OSError:
        return False
    kinds = dict(line.split()[1:3] for line in mounts)
    kilobytes = {line.split()[0]: int(line.split()[1]) for line in memory}
    return (
        kinds.get(str(folder)) == "tmpfs"
        and os.access(folder, os.W_OK)
        and not about.f_flag & os.ST_NOEXEC
        and about.f_bavail * about.f_frsize >= FILES_BYTES
        and kilobytes["MemAvailable:"] * 1024 >= FREE_BYTES
    )
