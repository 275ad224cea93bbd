"""The workers of a batch: a local cluster of Dask's, or one that is there already."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import dask
import distributed

from lightstage.counting import counted
from lightstage.errors import ConfigError, DeviceError
from processing.batch.config import BatchConfig
from processing.batch.work import POOLS, TOPIC, about, stop
from processing.errors import ProcessingError
from processing.parallel import THREADS, cores

STOP_S = 5.0
"""So long stages may take to their next sign of progress when a batch is stopped."""
GONE = (OSError, TimeoutError, distributed.comm.CommClosedError, RuntimeError)
"""What Dask raises where the scheduler does not answer."""


class Workers:
    """A connection to a scheduler and its workers.

    Attributes:
        address: of the scheduler.
        client: Dask's.
        events: the workers' reports of their progress, and the names of tasks that ended.
    """

    def __init__(
        self, address: str, local: distributed.LocalCluster | None, answer_s: float
    ) -> None:
        """Connect; ConfigError where no scheduler answers in so many seconds."""
        self.address = address
        self.events: queue.Queue[dict[str, Any]] = queue.Queue()
        self._local = local
        self._answer_s = answer_s
        self.client = self._connect()

    def _connect(self) -> distributed.Client:
        try:
            client = distributed.Client(self.address, timeout=self._answer_s, set_as_default=False)
        except (*GONE, ValueError) as error:
            raise ConfigError(
                "--scheduler",
                found=f"nothing that answers at {self.address} ({str(error)[:120]})",
                expected="the address of a Dask scheduler, such as tcp://HOST:8786",
                hint="Start one with `dask scheduler`, and check that its version of "
                f"distributed is {distributed.__version__}.",
            ) from None
        client.subscribe_topic(TOPIC, self._heard)
        return client

    def _heard(self, event: tuple[float, dict[str, Any]]) -> None:
        self.events.put({"kind": "progress", **event[1]})

    def slots(self) -> dict[str, int]:
        """Threads of each worker by its address.

        Raises:
            one of `GONE`: the scheduler does not answer.
        """
        return dict(self.client.nthreads())

    def submit(
        self, name: str, work: Callable[..., Any], *words: Any, on: list[str] | None
    ) -> distributed.Future:
        """Begin a task; an event of kind `ended` reports its end.

        Args:
            name: of the task, never used before.
            work: function of `processing.batch.work`.
            words: its arguments.
            on: addresses of workers that may do it; None for all.
        """
        future = self.client.submit(work, *words, key=name, pure=False, retries=0, workers=on)
        future.add_done_callback(lambda _: self.events.put({"kind": "ended", "name": name}))
        return future

    def restart(self, worker: str) -> None:
        """Kill a worker's process; its nanny starts another."""
        with contextlib.suppress(*GONE, ValueError):
            self.client.restart_workers([worker], timeout=30, raise_for_error=False)

    def alive(self) -> bool:
        """Whether the scheduler answers."""
        return self.client.status == "running"

    def again(self) -> bool:
        """Try to reach a scheduler that went away; whether it is there."""
        with contextlib.suppress(*GONE):
            self.client.close(timeout=1)
        try:
            self.client = self._connect()
        except ConfigError:
            return False
        return True

    def stop(self, batch: str, running: list[distributed.Future]) -> None:
        """Stop a batch's stages at their next sign of progress, and kill those that give none."""
        with contextlib.suppress(*GONE):
            self.client.run(stop, batch, on_error="ignore")
            until = time.monotonic() + STOP_S
            while time.monotonic() < until and not all(future.done() for future in running):
                time.sleep(0.05)
        for worker in self._nannies():
            worker.auto_restart = False
            with contextlib.suppress(OSError, TypeError, AttributeError):
                os.kill(worker.pid, signal.SIGKILL)

    def _nannies(self) -> list[Any]:
        return [] if self._local is None else list(self._local.workers.values())

    def close(self) -> None:
        """End the connection, and the workers where they are our own."""
        with contextlib.suppress(*GONE):
            self.client.close(timeout=5)


@contextlib.contextmanager
def open_workers(scheduler: str | None, count: int, config: BatchConfig) -> Iterator[Workers]:
    """Start workers on this machine, or connect to a scheduler.

    Args:
        scheduler: address; None for workers of our own.
        count: workers of our own, each with its share of the cores.
        config: settings.

    Raises:
        ConfigError: no scheduler at this address.
    """
    settings = {
        # A worker's death is reported at once: the batch counts the tries, and names the reason.
        "distributed.scheduler.allowed-failures": 0,
        "distributed.scheduler.worker-ttl": f"{config.stalled_s} s",
        "distributed.scheduler.work-stealing": False,
        "distributed.worker.daemon": True,
        "distributed.admin.log-format": "%(message)s",
        "logging.distributed": "critical",
    }
    with dask.config.set(settings), contextlib.ExitStack() as stack:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        local = None
        if scheduler is None:
            stack.enter_context(_threads(max(1, cores() // count)))
            scratch = tempfile.mkdtemp(prefix="lightstage-batch-")
            stack.callback(shutil.rmtree, scratch, ignore_errors=True)
            local = distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                # Dask would hold work back, or kill it, by files that are only mapped.
                memory_limit=0,
                dashboard_address=None,
                local_directory=scratch,
                silence_logs=logging.CRITICAL,
                preload=["processing.batch.setup_worker"],
            )
            stack.callback(local.close, timeout=10)
            scheduler = str(local.scheduler_address)
        workers = Workers(scheduler, local, config.answer_s)
        stack.callback(workers.close)
        yield workers


@contextlib.contextmanager
def _threads(count: int) -> Iterator[None]:
    """Hold what this process starts to a number of threads."""
    before = {name: os.environ.get(name) for name in (THREADS, *POOLS)}
    os.environ.update(dict.fromkeys(before, str(count)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def require_fit(
    workers: Workers,
    template: Path,
    out: Path,
    sessions: list[str],
    own: dict[str, Any],
    wait_s: float,
) -> int:
    """Refuse workers whose results would be others, or that do not see our disks.

    Args:
        workers: of the batch.
        template: folder.
        out: the batch's folder.
        sessions: folders.
        own: `about` of this process.
        wait_s: so long the first worker is waited for.

    Returns:
        The largest number of workers that share a machine.

    Raises:
        ProcessingError: all that does not fit, in one message.
    """
    client = workers.client
    try:
        client.wait_for_workers(1, timeout=wait_s)
    except TimeoutError:
        raise DeviceError(
            workers.address, found="no worker", expected="at least one", hint="Start workers first."
        ) from None
    problems: list[str] = []
    ours = distributed.__version__
    theirs = {
        f"{who} {name}": found["packages"]["distributed"]
        for who, each in (
            ("scheduler", {"": client.get_versions()["scheduler"]}),
            ("worker", client.get_versions()["workers"]),
        )
        for name, found in each.items()
    }
    problems += [
        f"{who.strip()}: found distributed {version}, expected {ours}"
        for who, version in theirs.items()
        if version != ours
    ]
    problems += [
        f"worker {name}: found {counted(count, 'thread')}, expected 1, "
        "since memory is reckoned by workers (`dask worker --nthreads 1`)"
        for name, count in workers.slots().items()
        if count != 1
    ]
    hosts: dict[str, int] = {}
    if not problems:
        answers = client.run(about, str(template), str(out), sessions, on_error="return")
        for name, found in answers.items():
            if isinstance(found, BaseException):
                problems.append(f"worker {name}: {type(found).__name__}: {str(found)[:200]}")
                continue
            hosts[found["host"]] = hosts.get(found["host"], 0) + 1
            problems += _differences(name, found, own, template, out)
    if problems:
        raise ProcessingError(
            workers.address,
            found="; ".join(problems[:10]) + ("; and more" if len(problems) > 10 else ""),
            expected="workers with this software, the template, the sessions and --out under the "
            "same paths",
            hint="Install the same version on every worker, and mount the same disks.",
        )
    return max(hosts.values(), default=1)


def _differences(
    name: str, found: dict[str, Any], own: dict[str, Any], template: Path, out: Path
) -> list[str]:
    problems = []
    if found["code"] != own["code"]:
        problems.append(f"worker {name}: found another version of this software")
    if found["template"] != own["template"]:
        what = "another" if found["template"] else "no"
        problems.append(f"worker {name}: found {what} template at {template}")
    if found["missing"]:
        problems.append(f"worker {name}: found no session at {found['missing']}")
    if not found["out"]:
        problems.append(f"worker {name}: cannot write to {out}")
    return problems
