"""Views of a session side by side, as many at once as the cores and the memory allow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec, TypeVar

T = TypeVar("T")
K = TypeVar("K")
P = ParamSpec("P")

THREADS = "LIGHTSTAGE_THREADS"
"""Environment variable: most threads of this process, where it shares the machine with others."""
BUDGET_BYTES = 5 * 2**29
"""What the views that are worked on at once may take together: 2.5 GiB."""


def cores() -> int:
    """Cores for this process: those that the system lets it use, or the share that it was given."""
    there = len(os.sched_getaffinity(0))
    share = os.environ.get(THREADS, "")
    return max(1, min(there, int(share))) if share.isdecimal() else there


def threads_of_worker(peers: int) -> int:
    """Threads for one of `peers` workers that share this machine's cores.

    Cores that the system has given to a worker alone, as SLURM does, are not shared.
    """
    own = len(os.sched_getaffinity(0))
    return own if own < (os.cpu_count() or own) else max(1, own // max(1, peers))


def workers(bytes_each: int, budget: int = BUDGET_BYTES) -> int:
    """How many views to work on at once: one a core, fewer where memory forbids, at least one.

    Args:
        bytes_each: that one view takes at most.
        budget: for all of them.
    """
    return max(1, min(cores(), budget // max(bytes_each, 1)))


def over_views(work: Callable[[K], T], views: Sequence[K], at_once: int) -> Iterator[tuple[K, T]]:
    """Work on views in threads and yield (view, result) in the order of `views`.

    A view is named as the caller likes: by its camera, by its number.

    Compiled loops, files and pictures run beside each other; at most `at_once` results wait. An
    error of one view ends the others that have not begun, and is raised.
    """
    with ThreadPoolExecutor(at_once) as pool:
        waiting: list[tuple[K, Future[T]]] = []
        rest = list(views)
        try:
            while rest or waiting:
                while rest and len(waiting) < at_once:
                    view = rest.pop(0)
                    waiting.append((view, pool.submit(work, view)))
                # No name may hold a result here: it is let go when the caller lets it go.
                yield waiting[0][0], waiting.pop(0)[1].result()
        finally:
            for _, future in waiting:
                future.cancel()


class Behind:
    """Work done while its giver continues, in the order given; a with block ends when all is done.

    An error of it is raised by a later `do`, or at the end; what has not begun then is left out.
    """

    def __init__(self, most: int) -> None:
        """At most so many at once, the giver waits where there are more."""
        self._most = most
        self._pool = ThreadPoolExecutor(most)
        self._waiting: list[Future[object]] = []

    def __enter__(self) -> Behind:
        return self

    def do(self, work: Callable[P, object], *args: P.args, **more: P.kwargs) -> None:
        """Begin, after the oldest has ended where as many as may be are under way."""
        if len(self._waiting) == self._most:
            self._waiting.pop(0).result()
        self._waiting.append(self._pool.submit(work, *args, **more))

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        del rest
        try:
            while kind is None and self._waiting:
                self._waiting.pop(0).result()
        finally:
            self._pool.shutdown(cancel_futures=True)
