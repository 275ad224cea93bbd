"""What a worker of a batch does: one stage of one session. Paths and facts travel, never arrays.

This file is imported by every worker before the libraries that compute, so that their threads can
be held to the worker's share first: nothing that computes is imported at its head.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import socket
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lightstage.commands.progress import ProgressCallback
from lightstage.errors import DiskFullError, LightstageError, MemoryLimitError
from lightstage.failures import explain
from processing.parallel import THREADS, threads_of_worker

if TYPE_CHECKING:
    from processing.pipeline_config import PipelineConfig

TOPIC = "lightstage-batch"
"""Name of the events in which workers report their progress."""
PROGRESS_EVERY_S = 2.0
POOLS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
Status = Literal["done", "busy", "again", "disk full", "unfit", "failed", "stopped"]


@dataclasses.dataclass(frozen=True)
class Order:
    """One session of a batch, as workers receive it.

    Attributes:
        batch: id of the batch, under which it can be stopped.
        session: folder.
        out: the processed folder.
        template: folder.
        config: of all stages.
        until: the last stage.
        peers: workers that share a machine, at most; each has its share of the cores.
        code: hash of the code that results depend on, which the worker's must be.
        template_hash: of the template's files, which the worker's must be.
    """

    batch: str
    session: str
    out: str
    template: str
    config: PipelineConfig
    until: str
    peers: int
    code: str
    template_hash: str


@dataclasses.dataclass(frozen=True)
class Answer:
    """What came of an order.

    Attributes:
        status: `done`; `busy` where another run holds the folder; `again` where another try may
            do; `disk full`; `unfit` where the worker has other code or another template; `failed`
            where only the user can mend it; `stopped`.
        worker: its address.
        ran: the stage that ran, None where none did.
        left: stages that are not up to date.
        reported: whether report.html, and maps in views/, are of the last stage.
        facts: the facts of the stages that are done, by name.
        reason: why not, in words, and what to try.
        trace: of a defect of ours, for its report.
    """

    status: Status
    worker: str
    ran: str | None = None
    left: tuple[str, ...] = ()
    reported: bool = False
    facts: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    reason: str = ""
    trace: str = ""


class StoppedWork(BaseException):
    """The batch was stopped while a stage ran."""


_stopped: set[str] = set()


def stop(batch: str) -> None:
    """Stop a batch's work in this process at its next sign of progress."""
    _stopped.add(batch)


def hold_threads(count: int) -> None:
    """Hold the libraries of this process to a number of threads, before they are imported."""
    os.environ[THREADS] = str(count)
    for name in POOLS:
        os.environ[name] = str(count)
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    import cv2

    cv2.setNumThreads(count)


def about(template: str, out: str, sessions: list[str]) -> dict[str, Any]:
    """What must agree before work begins: code, template, and what this machine sees of the disks.

    Args:
        template: folder.
        out: the batch's folder.
        sessions: folders, of which the first that is missing is named.
    """
    from processing.records import code_version, hash_template

    place = Path(template)
    return {
        "host": socket.gethostname(),
        "code": code_version(),
        "template": hash_template(place) if (place / "template.json").is_file() else None,
        "out": os.access(out, os.W_OK),
        "missing": next((s for s in sessions if not Path(s, "session.json").is_file()), None),
    }


def look(order: Order) -> Answer:
    """Which stages of a session are not up to date, without reading its photographs."""
    return _answered(order, None)


def step(order: Order, verified: bool) -> Answer:
    """Run the first stage of a session that is not up to date.

    Args:
        order: whose.
        verified: hold every photograph against its hash first.
    """
    return _answered(order, verified)


def _answered(order: Order, verified: bool | None) -> Answer:
    """The work itself, and what went wrong in words."""
    worker = _address()
    try:
        hold_threads(threads_of_worker(order.peers))
        unfit = _unfit(order)
        if unfit:
            return Answer("unfit", worker, reason=unfit)
        return _work(order, verified, worker)
    except StoppedWork:
        return Answer("stopped", worker, reason="The batch was stopped.")
    except Exception as error:
        return _failed(error, worker)


def _work(order: Order, verified: bool | None, worker: str) -> Answer:
    from lightstage.formats.access import group_of, limited_access
    from processing import pipeline
    from processing.records import read_records

    session, out = Path(order.session), Path(order.out)
    with limited_access(group_of([session])):
        job = pipeline.read_job(
            session, out, Path(order.template), order.config, order.until, verified=bool(verified)
        )
        ran: str | None = None
        if verified is None:
            left = pipeline.left_to_do(job, order.until)
        else:
            ran, left = pipeline.run_next(job, order.until, _progress(order))
    facts = {name: record.facts for name, record in read_records(out).items()}
    reported = pipeline.is_reported(job, order.until)
    return Answer("done", worker, ran, tuple(left), reported, facts)


def _unfit(order: Order) -> str:
    """Why this worker's results would be others than those of the batch; empty where they are."""
    from processing.records import code_version, hash_template

    host = socket.gethostname()
    if code_version() != order.code:
        return f"worker on {host}: found another version of this software, expected the batch's"
    place = Path(order.template)
    there = (place / "template.json").is_file()
    if not there or hash_template(place) != order.template_hash:
        found = "another template" if there else "no template"
        return f"worker on {host}: found {found} at {place}, expected the batch's"
    return ""


def _failed(error: Exception, worker: str) -> Answer:
    from processing.pipeline import BusyError

    explained = explain(error)
    if explained is None:
        trace = "".join(traceback.format_exception(error))
        reason = f"a defect of this software: {type(error).__name__}: {error}"
        return Answer("failed", worker, reason=reason[:2000], trace=trace[-20000:])
    status: Status = "failed"
    if isinstance(explained, BusyError):
        status = "busy"
    elif isinstance(explained, DiskFullError):
        status = "disk full"
    elif isinstance(explained, MemoryLimitError) or not isinstance(error, LightstageError):
        # The system's report, not a fault of the files: elsewhere, or later, the stage may succeed.
        status = "again"
    return Answer(status, worker, reason=str(explained)[:4000])


def _progress(order: Order) -> Any:
    """A pipeline's bar that reports progress to the batch, and ends a stage that is stopped."""

    @contextlib.contextmanager
    def bar(stage: str) -> Iterator[ProgressCallback]:
        sent_s = 0.0

        def progress(done: int, total: int) -> None:
            nonlocal sent_s
            if order.batch in _stopped:
                raise StoppedWork
            if time.monotonic() - sent_s >= PROGRESS_EVERY_S:
                sent_s = time.monotonic()
                _report({"out": order.out, "stage": stage, "done": done, "total": total})

        progress(0, 0)
        yield progress

    return bar


def _report(event: dict[str, Any]) -> None:
    from distributed import get_worker

    with contextlib.suppress(ValueError):  # outside a worker, as in a test, nobody listens
        worker = get_worker()
        worker.log_event(TOPIC, {**event, "worker": worker.address})


def _address() -> str:
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return "this process"
