"""A camera's process ends with its parent, however that ends and whatever the driver is doing.

The parent holds one end of a pipe of which the child has the other. When the parent is gone, the
kernel closes its end, and sends the child SIGKILL because of it (Linux: ``F_SETSIG`` on a pipe
with ``O_ASYNC``, fcntl(2)). No line of Python need run for that: a driver may hang in C with
Python's lock in its hand. ``PR_SET_PDEATHSIG`` does not serve: it follows the thread that made the
child, and cameras are opened by threads that end.
"""

from __future__ import annotations

import fcntl
import os
import select
import signal


def end_with(handle: int) -> None:
    """Be killed when the pipe's other end is closed.

    Args:
        handle: the pipe's end for reading; nothing is ever written to the other.
    """
    fcntl.fcntl(handle, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(handle, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(handle, fcntl.F_SETFL, fcntl.fcntl(handle, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([handle], [], [], 0)[0]:  # it was closed before the signal was set up
        os._exit(1)
