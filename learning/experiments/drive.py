"""Many runs, several at once: in processes of this machine, or on the workers of a Dask scheduler.

Each run is one task, whose folder shows whether it is finished. Nothing else is remembered, so
that a call which was killed, or which ran out of time, is resumed by the next one.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import Any, TypeVar

from learning.experiments.work import Order, one_run
from lightstage.errors import ConfigError, MemoryLimitError
from lightstage.interrupts import raise_on_signals

STOP = ".stop"
"""File in an experiment's folder at whose sight runs stop."""
THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
LOOK_S = 1.0
"""So often a worker looks whether the command that began it is still there."""
ANSWER_S = 20.0
"""So long a scheduler may take to answer."""
MOST_AT_ONCE = 10_000
"""Runs that a scheduler is given at once."""
ResultT = TypeVar("ResultT")


def run_all(
    orders: list[Order],
    jobs: int,
    scheduler: str | None,
    ended: Callable[[Order, dict[str, Any]], None],
    work: Callable[[Order], dict[str, Any] | None] = one_run,
) -> list[tuple[Order, Exception]]:
    """Do all runs that are not finished; returns those that failed, and by what.

    A refinement is begun once the run whose network it refines is finished.

    Args:
        orders: of the runs, in the order in which they are begun.
        jobs: runs at once on this machine.
        scheduler: address of a Dask scheduler, whose workers do the runs instead.
        ended: called with each run that ended and its figures.
        work: what is done for each.

    Raises:
        ConfigError: no scheduler at this address.
        MemoryLimitError: a process that was killed.
    """
    failed: list[tuple[Order, Exception]] = []
    waiting = list(orders)
    begun: dict[Future[Any], Order] = {}
    room = jobs if scheduler is None else MOST_AT_ONCE
    with _executor(jobs, scheduler) as executor:
        try:
            while waiting or begun:
                ready = [one for one in waiting if _ready(one, [*waiting, *begun.values()])]
                for order in ready[: room - len(begun)]:
                    waiting.remove(order)
                    begun[executor.submit(work, order)] = order
                over, _ = concurrent.futures.wait(
                    begun, return_when=concurrent.futures.FIRST_COMPLETED
                )
                for future in over:
                    order = begun.pop(future)
                    error = future.exception()
                    if error is None:
                        ended(order, future.result() or {})
                    elif isinstance(error, BrokenExecutor) or not isinstance(error, Exception):
                        raise error
                    else:
                        failed.append((order, error))
        except BaseException as error:
            for future in begun:
                future.cancel()
            for order in begun.values():
                if order.stop is not None:
                    order.stop.touch()
            if not isinstance(error, BrokenExecutor):
                raise
            raise MemoryLimitError(
                "experiment",
                found="a run's process that was killed",
                expected="processes that end by themselves",
                hint="Does the memory hold so many --jobs? The same call resumes the runs.",
            ) from None
    return failed


def _ready(order: Order, others: list[Order]) -> bool:
    """Whether no run that this one needs is still to be done."""
    return not order.variant.refines or all(other.folder != order.source for other in others)


@contextlib.contextmanager
def _executor(jobs: int, scheduler: str | None) -> Iterator[Executor]:
    if scheduler is not None:
        # Dask takes a second to import, and few have a scheduler.
        from learning.experiments.workers import dask_executor

        with dask_executor(scheduler, ANSWER_S) as executor:
            yield executor
    elif jobs == 1:
        yield Here()
    else:
        with _threads(max(1, len(os.sched_getaffinity(0)) // jobs)):
            context = multiprocessing.get_context("spawn")
            given = (os.getpid(),)
            with concurrent.futures.ProcessPoolExecutor(jobs, context, _begin, given) as pool:
                yield pool


class Here(Executor):
    """Does each run at once, in this process."""

    def submit(self, fn: Callable[..., ResultT], /, *args: Any, **kwargs: Any) -> Future[ResultT]:
        """A future that is over."""
        future: Future[ResultT] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def _begin(parent: int) -> None:
    """Prepare a worker's process: it ends with the command that began it, however that ends."""
    raise_on_signals()

    def end_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_S)
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


@contextlib.contextmanager
def _threads(count: int) -> Iterator[None]:
    """Hold what this process starts to a number of threads, unless the user chose one."""
    chosen = {name: str(count) for name in THREADS if name not in os.environ}
    os.environ.update(chosen)
    try:
        yield
    finally:
        for name in chosen:
            del os.environ[name]


def stop_file(out: Path) -> Path:
    """The file that stops all runs of an experiment; one of an earlier call is removed."""
    path = out / STOP
    path.unlink(missing_ok=True)
    return path


def no_scheduler(address: str, reason: str, version: str) -> ConfigError:
    """Nothing answers at an address."""
    return ConfigError(
        "--scheduler",
        found=f"nothing that answers at {address} ({reason[:120]})",
        expected="the address of a Dask scheduler, such as tcp://HOST:8786",
        hint="Start one with `dask scheduler`, and check whether its version of distributed is "
        f"{version}.",
    )
