"""Workers that do not fit a batch are named before it begins; a real scheduler goes away."""

from __future__ import annotations

import os
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import distributed
import pytest

from benchmarks.folders import differences, holder
from lightstage.errors import LightstageError
from lightstage.formats.template import default_template_path
from processing.batch import work
from processing.batch.cluster import require_fit
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from processing.records import RUN_LOCK
from tests.documents import ROOT
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball

TEMPLATE = default_template_path()
OURS = distributed.__version__


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("sessions") / "ball"
    return lit_ball.write_session(Ball(), lit_ball.small_rig(2, 0.015), root)


class FakeClient:
    """What Dask's client says of a scheduler and of workers that a test describes."""

    def __init__(self, scheduler: str, workers: dict[str, dict[str, Any]]) -> None:
        self.scheduler, self.workers = scheduler, workers
        self.ran: list[Callable[..., Any]] = []

    def wait_for_workers(self, count: int, timeout: float) -> None:
        assert timeout > 0
        if len(self.workers) < count:
            raise TimeoutError

    def get_versions(self) -> dict[str, Any]:
        def of(version: str) -> dict[str, Any]:
            return {"packages": {"distributed": version}}

        found = {name: of(each.get("version", OURS)) for name, each in self.workers.items()}
        return {"scheduler": of(self.scheduler), "workers": found}

    def run(self, asked: Callable[..., Any], *words: Any, on_error: str) -> dict[str, Any]:
        assert on_error == "return"
        self.ran.append(asked)
        own = asked(*words)
        return {
            name: each["raises"] if "raises" in each else {**own, **each.get("about", {})}
            for name, each in self.workers.items()
        }


class FakeWorkers:
    address = "tcp://somewhere:8786"

    def __init__(self, scheduler: str, workers: dict[str, dict[str, Any]]) -> None:
        self.client = FakeClient(scheduler, workers)

    def slots(self) -> dict[str, int]:
        return {name: each.get("threads", 1) for name, each in self.client.workers.items()}


def fit(workers: FakeWorkers, session: Path, out: Path) -> int:
    out.mkdir()
    own = work.about(str(TEMPLATE), str(out), [str(session)])
    return require_fit(workers, TEMPLATE, out, [str(session)], own, 0.1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("scheduler", "worker", "message"),
    [
        ("2020.1.0", {}, f"scheduler: found distributed 2020.1.0, expected {OURS}"),
        (OURS, {"version": "2020.1.0"}, f"worker w1: found distributed 2020.1.0, expected {OURS}"),
        (OURS, {"threads": 8}, "worker w1: found 8 threads, expected 1"),
        (OURS, {"about": {"code": "old"}}, "worker w1: found another version of this software"),
        (OURS, {"about": {"template": None}}, f"worker w1: found no template at {TEMPLATE}"),
        (OURS, {"about": {"template": "x"}}, f"worker w1: found another template at {TEMPLATE}"),
        (OURS, {"about": {"missing": "/a/b"}}, "worker w1: found no session at /a/b"),
        (OURS, {"about": {"out": False}}, "worker w1: cannot write to "),
        (OURS, {"raises": ModuleNotFoundError("lightstage")}, "worker w1: ModuleNotFoundError"),
    ],
)
def test_what_does_not_fit_is_refused_by_worker_and_before_any_work(
    session: Path, tmp_path: Path, scheduler: str, worker: dict[str, Any], message: str
) -> None:
    workers = FakeWorkers(scheduler, {"w0": {}, "w1": worker})
    with pytest.raises(LightstageError) as caught:
        fit(workers, session, tmp_path / "out")
    assert message in str(caught.value)
    assert "tcp://somewhere:8786" in str(caught.value)
    assert "worker w0" not in str(caught.value)
    assert "Install the same version on every worker" in str(caught.value)
    # Of another version nothing is asked: it may not even understand the question.
    assert workers.client.ran == ([] if "expected" in message else [work.about])


def test_all_that_does_not_fit_is_reported_at_once(session: Path, tmp_path: Path) -> None:
    wrong = {f"w{i}": {"about": {"code": "old", "template": None}} for i in range(3)}
    with pytest.raises(LightstageError) as caught:
        fit(FakeWorkers(OURS, wrong), session, tmp_path / "out")
    assert str(caught.value).count("another version of this software") == 3
    assert str(caught.value).count("no template") == 3


def test_workers_that_fit_are_counted_by_machine(session: Path, tmp_path: Path) -> None:
    names = {"w0": "one", "w1": "two", "w2": "two"}
    fitting = {name: {"about": {"host": host}} for name, host in names.items()}
    assert fit(FakeWorkers(OURS, fitting), session, tmp_path / "out") == 2


def test_a_scheduler_without_workers_is_reported(session: Path, tmp_path: Path) -> None:
    with pytest.raises(LightstageError, match="found no worker, expected at least one"):
        fit(FakeWorkers(OURS, {}), session, tmp_path / "out")


class Cluster:
    """A scheduler and a worker in processes of their own, at one port."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def start(self) -> None:
        own = ["--host", "127.0.0.1", "--no-dashboard"]
        self._spawn("scheduler", *own, "--port", str(self.port), "--no-show")
        own = ["--nthreads", "1", "--memory-limit", "0", "--no-dashboard", "--no-nanny"]
        self._spawn("worker", self.address, *own, "--local-directory", str(self.folder))

    def _spawn(self, kind: str, *words: str) -> None:
        command = [sys.executable, "-m", "distributed.cli.dask_" + kind, *words]
        quiet = subprocess.DEVNULL
        env = {**os.environ, "PYTHONPATH": str(ROOT)}
        self.processes.append(subprocess.Popen(command, env=env, stdout=quiet, stderr=quiet))

    def kill(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
        self.processes.clear()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    made = Cluster(tmp_path / "scratch")
    made.start()
    yield made
    made.kill()


@pytest.mark.slow
def test_a_scheduler_that_goes_away_in_the_middle_and_comes_back_costs_nothing(
    session: Path, tmp_path: Path, cluster: Cluster, run_command: Callable[..., Any]
) -> None:
    out = tmp_path / "out"
    gone: queue.Queue[bool] = queue.Queue()

    def take_away() -> None:
        lock = out / "ball" / RUN_LOCK
        until = time.monotonic() + 120
        while time.monotonic() < until:
            if holder(lock) is not None:
                cluster.kill()
                time.sleep(2)
                cluster.start()
                gone.put(True)
                return
            time.sleep(0.002)

    thread = threading.Thread(target=take_away, daemon=True)
    thread.start()
    words = ("batch", session, "--out", out, "--until", "decode")
    done = run_command("processing", *words, "--scheduler", cluster.address)
    thread.join()
    assert gone.get_nowait()
    assert done.code == 0, done.err
    run(session, tmp_path / "alone", TEMPLATE, PipelineConfig(), until="decode")
    assert differences(out / "ball", tmp_path / "alone") == []
