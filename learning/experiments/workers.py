"""The workers of a Dask scheduler that is there already, as an executor."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from concurrent.futures import Executor

import distributed

from learning.experiments.drive import no_scheduler

GONE = (OSError, TimeoutError, distributed.comm.CommClosedError, RuntimeError, ValueError)
"""What Dask raises where a scheduler does not answer."""


@contextlib.contextmanager
def dask_executor(address: str, answer_s: float) -> Iterator[Executor]:
    """Connect to a scheduler within the block; its workers see our disks under the same paths.

    Raises:
        ConfigError: nothing answers in so many seconds.
    """
    try:
        client = distributed.Client(address, timeout=answer_s, set_as_default=False)
    except GONE as error:
        raise no_scheduler(address, str(error), distributed.__version__) from None
    with client:
        yield client.get_executor(pure=False)
