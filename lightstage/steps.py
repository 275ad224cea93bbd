"""Named steps of a photograph's life, where a test may stop a real process and kill it.

``LIGHTSTAGE_STOP_FILE`` names a file of one line, ``STEP PATTERN CAMERA`` (``*`` is any).
The first process that comes to that step removes the file and stops (SIGSTOP), as if its machine
hung; whoever wrote the file may inspect, and continue or kill it. Without the variable a step
does nothing.
"""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

STEPS = (
    # one shot, in the capture's process
    "lit",
    "intended",
    "exposed",
    # one photograph, in the camera's process
    "triggering",
    "triggered",
    "downloading",
    "downloaded",
    # one photograph, in the capture's process
    "sized",
    "parsed",
    "hashed",
    "flushed",
    "named",
    "folder-flushed",
    "line-half-written",
    "journaled",
    "checked",
    "deleting",
    "deleted",
    # the session
    "shot-done",
    "session-written",
    "manifest-written",
    "ended",
)
"""Steps in their order, as docs/capture.md has them."""


def step(name: str, pattern: str = "*", camera: str = "*") -> None:
    """Mark a step as done; stops the process where a test waits for it.

    Args:
        name: of STEPS; at its end, unless it ends in -ing or is called half.
        pattern: whose photograph, ``*`` where it is no matter of one.
        camera: whose photograph, ``*`` where it is no matter of one.
    """
    file = os.environ.get("LIGHTSTAGE_STOP_FILE")
    if file is None:
        return
    assert name in STEPS, name
    path = Path(file)
    try:
        wanted = path.read_text().split()
    except OSError:
        return
    here = (name, pattern, camera)
    if len(wanted) != 3 or any(w not in ("*", h) for w, h in zip(wanted, here, strict=True)):
        return
    try:
        path.unlink()  # only one process or thread gets it
    except FileNotFoundError:
        return
    # To this thread: sent to the process, another thread may take it while this one continues.
    signal.pthread_kill(threading.get_ident(), signal.SIGSTOP)
