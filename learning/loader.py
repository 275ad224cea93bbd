"""Batches made ahead: the next one in a thread, while the network takes the step of this one."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, TypeVar

import numba

BatchT = TypeVar("BatchT")
SAFE_LAYERS = ("omp", "tbb")
"""Those of numba's layers of threads that several threads may use at once [Numba2024]."""


def threads_may_render() -> bool:
    """Whether two threads may use the compiled renderer at once.

    Numba knows its layer once a parallel loop has run: before that the answer is no.
    """
    try:
        return numba.threading_layer() in SAFE_LAYERS
    except ValueError:
        return False


class Ahead(Generic[BatchT]):
    """Makes what each step is fed with, one step ahead; a step's batch follows from its number.

    So nothing of a batch depends on when it was made. Nobody else may draw from the same data
    within the `with` block.
    """

    def __init__(self, make: Callable[[int], BatchT]) -> None:
        """`make(number)` makes the batch of step `number`."""
        self._make = make
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="batches")
        self._next: tuple[int, Future[BatchT]] | None = None

    def get(self, number: int) -> BatchT:
        """The batch of a step; begins with the one after it. What `make` raised is raised here."""
        if self._next is None or self._next[0] != number:
            self._next = (number, self._thread.submit(self._make, number))
        batch = self._next[1].result()
        self._next = (number + 1, self._thread.submit(self._make, number + 1))
        return batch

    def aside(self, make: Callable[[int], BatchT], number: int) -> BatchT:
        """Another batch, made by the same thread: the data are no other's to draw from."""
        return self._thread.submit(make, number).result()

    def __enter__(self) -> Ahead[BatchT]:
        """Nothing is made yet."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait for the batch in the making, which nobody needs."""
        self._thread.shutdown(wait=True, cancel_futures=True)
