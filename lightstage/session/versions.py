"""What software and system a capture ran on; nothing of whose machine it was."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
import sys
from pathlib import Path

from lightstage import __version__

PACKAGES = ("numpy", "gphoto2", "pyserial", "opencv-contrib-python-headless")
_ASK_LIBRARY = "import gphoto2; print(gphoto2.gp_library_version(gphoto2.GP_VERSION_SHORT)[0])"
_WAIT_S = 20.0


def software_versions() -> dict[str, str | None]:
    """Versions by name; None where something is not there.

    ``commit`` is that of this software's own repository, with ``-dirty`` where files were changed.
    libgphoto2 is asked in a process of its own: a capture's own process never loads it.
    """
    return {
        "lightstage": __version__,
        "commit": _commit(),
        "python": platform.python_version(),
        **{name: _package(name) for name in PACKAGES},
        "libgphoto2": _output([sys.executable, "-c", _ASK_LIBRARY]),
    }


def system_facts() -> dict[str, str]:
    """Operating system and processor, without the machine's name."""
    return {
        "system": platform.system(),
        "release": platform.release(),
        "machine": platform.machine(),
    }


def _package(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():  # not some other repository that holds an environment
        return None
    return _output(["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"])


def _output(command: list[str]) -> str | None:
    """The one line that a program prints; None where it fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_WAIT_S)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None if done.returncode == 0 else None
