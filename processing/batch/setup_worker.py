"""Loaded by each worker of a local batch at its start."""

from __future__ import annotations

import signal


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the batch: the terminal sends it to the workers too.

    Args:
        worker: Dask's, which has this name for what is called at a worker's start.
    """
    del worker
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
