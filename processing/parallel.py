"""Views of a session side by side, as many at once as the cores and the memory allow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

BUDGET_BYTES = 5 * 2**29
"""What the views that are worked on at once may take together: 2.5 GiB."""


def workers(bytes_each: int, budget: int = BUDGET_BYTES) -> int:
    """How many views to work on at once: one a core, fewer where memory forbids, at least one.

    Args:
        bytes_each: that one view takes at most.
        budget: for all of them.
    """
    cores = len(os.sched_getaffinity(0))
    return max(1, min(cores, budget // max(bytes_each, 1)))


def over_views(
    work: Callable[[str], T], cameras: Sequence[str], at_once: int
) -> Iterator[tuple[str, T]]:
    """Work on views in threads and yield (camera, result) in the order of `cameras`.

    Compiled loops, files and pictures run beside each other; at most `at_once` results wait. An
    error of one view ends the others that have not begun, and is raised.
    """
    with ThreadPoolExecutor(at_once) as pool:
        waiting: list[tuple[str, Future[T]]] = []
        rest = list(cameras)
        try:
            while rest or waiting:
                while rest and len(waiting) < at_once:
                    camera = rest.pop(0)
                    waiting.append((camera, pool.submit(work, camera)))
                camera, future = waiting.pop(0)
                yield camera, future.result()
        finally:
            for _, future in waiting:
                future.cancel()
