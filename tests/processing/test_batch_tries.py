"""What a batch does with what its workers answer, on workers that answer as a test says."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any

import distributed
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from processing.batch.config import BatchConfig
from processing.batch.drive import Batch, Item
from processing.batch.figures import FEWEST, MAD_TO_SIGMA, robust_z
from processing.batch.work import Answer, Order, look
from processing.pipeline_config import PipelineConfig

KILLED = distributed.KilledWorker("task", None, 0)


class FakeFuture:
    def __init__(self, outcome: object) -> None:
        failed = isinstance(outcome, Exception)
        self.outcome = outcome
        self.status = "pending" if outcome is None else "error" if failed else "finished"

    def result(self) -> object:
        return self.outcome

    def exception(self) -> object:
        return self.outcome

    def cancel(self) -> None:
        self.status = "cancelled"

    def done(self) -> bool:
        return self.status != "pending"


class FakeWorkers:
    """Workers whose answers a function gives: `answer(session, is_look, nth) -> outcome`."""

    address = "fake"

    def __init__(self, answer: Callable[[str, bool, int], object], count: int = 2) -> None:
        self.answer, self.count = answer, count
        self.events: queue.Queue[dict[str, Any]] = queue.Queue()
        self.calls: list[tuple[str, bool, tuple[str, ...] | None]] = []
        self.restarted: list[str] = []
        self.away = 0

    def slots(self) -> dict[str, int]:
        return {f"w{i}": 1 for i in range(self.count)}

    def alive(self) -> bool:
        return self.away == 0

    def again(self) -> bool:
        self.away -= 1
        return self.away == 0

    def submit(self, name: str, work: object, order: Order, *_: object, on: Any) -> FakeFuture:
        nth = sum(call[:2] == (order.session, work is look) for call in self.calls)
        self.calls.append((order.session, work is look, None if on is None else tuple(on)))
        outcome = self.answer(order.session, work is look, nth)
        if outcome is None:
            self.events.put({"kind": "progress", "out": order.out, "worker": "w0"})
        else:
            self.events.put({"kind": "ended", "name": name})
        return FakeFuture(outcome)

    def restart(self, worker: str) -> None:
        self.restarted.append(worker)

    def stop(self, *_: object) -> None:
        raise AssertionError("nothing stopped this batch")


def batch_of(names: str, workers: FakeWorkers, **config: float) -> Batch:
    items = [
        Item(
            Order("b", name, f"/out/{name}", "/t", PipelineConfig(), "atlas", 1, "", ""),
            name,
            "P1",
            "neutral",
            1.0,
        )
        for name in names
    ]
    made = Batch(items, workers, BatchConfig(**config))  # type: ignore[arg-type]
    made.run()
    return made


def done(left: tuple[str, ...] = (), ran: str | None = None) -> Answer:
    return Answer("done", "w0", ran, left, not left)


def two_stages(session: str, looked: bool, nth: int) -> Answer:
    """A session of two stages that go well."""
    del session
    if looked:
        return done(("decode", "separate"))
    return (done(("separate",), "decode"), done((), "separate"))[nth]


def states(batch: Batch) -> str:
    return " ".join(item.state for item in batch.items)


def test_sessions_go_from_stage_to_stage_and_those_begun_go_first() -> None:
    workers = FakeWorkers(two_stages, count=1)
    batch = batch_of("abc", workers)
    assert states(batch) == "done done done"
    assert [c[0] for c in workers.calls] == ["a", "b", "c", "a", "a", "b", "b", "c", "c"]
    assert [c[1] for c in workers.calls[:3]] == [True, True, True]


def test_what_is_up_to_date_is_only_looked_at() -> None:
    workers = FakeWorkers(lambda *_: done())
    assert states(batch_of("ab", workers)) == "done done"
    assert all(looked for _, looked, _ in workers.calls)


@pytest.mark.parametrize("outcome", [KILLED, Answer("again", "w0", reason="memory")])
def test_a_stage_is_given_up_after_so_many_tries_and_the_others_go_on(outcome: object) -> None:
    def answer(session: str, looked: bool, nth: int) -> object:
        return outcome if session == "b" and not looked else two_stages(session, looked, nth)

    workers = FakeWorkers(answer)
    batch = batch_of("abc", workers, tries=4)
    assert states(batch) == "done failed done"
    assert sum(c[:2] == ("b", False) for c in workers.calls) == 4
    assert "decode was begun 4 times, the last time: " in batch.items[1].reason


def test_tries_are_counted_by_stage() -> None:
    outcomes = [KILLED, KILLED, done(("separate",), "decode"), KILLED, KILLED, done((), "separate")]

    def answer(_: str, looked: bool, nth: int) -> object:
        return done(("decode", "separate")) if looked else outcomes[nth]

    assert states(batch_of("a", FakeWorkers(answer), tries=3)) == "done"


def test_bad_input_is_tried_once() -> None:
    def answer(_: str, looked: bool, nth: int) -> object:
        del nth
        return done(("decode",)) if looked else Answer("failed", "w0", reason="no photograph")

    workers = FakeWorkers(answer)
    assert states(batch_of("a", workers)) == "failed"
    assert len(workers.calls) == 2


def test_a_full_disk_begins_nothing_more() -> None:
    def answer(session: str, looked: bool, nth: int) -> object:
        if session == "a" and not looked:
            return Answer("disk full", "w0", reason="found a full disk")
        return two_stages(session, looked, nth)

    workers = FakeWorkers(answer, count=1)
    batch = batch_of("ab", workers)
    assert states(batch) == "waiting waiting"
    assert batch.full == "found a full disk"
    assert [c for c in workers.calls if c[:2] == ("b", False)] == []


def test_a_folder_that_stays_busy_is_given_up_in_the_end() -> None:
    def answer(_: str, looked: bool, nth: int) -> object:
        del nth
        return done(("decode",)) if looked else Answer("busy", "w0", reason="another run")

    batch = batch_of("a", FakeWorkers(answer), busy_s=0.0)
    assert (states(batch), batch.items[0].reason) == ("failed", "another run")


def test_a_worker_of_another_version_gets_no_more_work() -> None:
    def answer(session: str, looked: bool, nth: int) -> object:
        if looked:
            return done(("decode", "separate"))
        # One after the other, as often as a session may be tried.
        unfit = [Answer("unfit", f"w{k + 1}", reason="old") for k in range(BatchConfig.tries)]
        return unfit[nth] if nth < len(unfit) else two_stages("", False, nth - len(unfit))

    workers = FakeWorkers(answer, BatchConfig.tries + 1)
    batch = batch_of("a", workers)
    assert (states(batch), batch.items[0].tries) == ("done", 0)
    assert workers.calls[-1][2] == ("w0",)


def test_a_batch_of_which_no_worker_fits_any_more_ends_and_gives_the_reason() -> None:
    def answer(_: str, looked: bool, nth: int) -> object:
        if looked:
            return done(("decode",))
        return Answer("unfit", f"w{nth}", reason="found another version")

    batch = batch_of("a", FakeWorkers(answer), away_s=1.0)
    assert states(batch) == "waiting"
    assert batch.gone == "no worker that fits came within 1 s: found another version"


def test_a_stage_without_progress_has_its_worker_killed_and_is_done_again() -> None:
    def answer(_: str, looked: bool, nth: int) -> object:
        if looked:
            return done(("decode",))
        return None if nth == 0 else done((), "decode")

    workers = FakeWorkers(answer)
    batch = batch_of("a", workers, stalled_s=1.0)
    assert (states(batch), workers.restarted) == ("done", ["w0"])


def test_a_scheduler_that_comes_back_finds_all_looked_at_again() -> None:
    workers = FakeWorkers(lambda *_: done())

    def answer(session: str, looked: bool, nth: int) -> object:
        if looked and nth == 0 and session == "a":
            workers.away = 3
            return None
        return done()

    workers.answer = answer
    assert states(batch_of("ab", workers)) == "done done"


def twin_z(values: list[float]) -> list[float]:
    """The modified z-score, plainly."""
    middle = sorted(values)
    count = len(values)
    median = (middle[(count - 1) // 2] + middle[count // 2]) / 2
    apart = sorted(abs(v - median) for v in values)
    mad = (apart[(count - 1) // 2] + apart[count // 2]) / 2
    scale = MAD_TO_SIGMA * mad or 1.253314 * sum(apart) / count
    return [max(-1e6, min(1e6, (v - median) / scale)) if scale else 0.0 for v in values]


@given(st.lists(st.floats(-1e6, 1e6).map(lambda v: round(v, 3)), min_size=FEWEST, max_size=40))
def test_robust_z_is_the_modified_z_score(values: list[float]) -> None:
    np.testing.assert_allclose(robust_z(values), twin_z(values), rtol=1e-6, atol=1e-6)


@given(st.lists(st.none() | st.floats(allow_nan=True, allow_infinity=True), max_size=30))
def test_robust_z_is_finite_whatever_a_report_says(values: list[float | None]) -> None:
    z = robust_z(values)
    assert z.shape == (len(values),)
    assert np.isfinite(z).all()
    for value, far in zip(values, z, strict=True):
        if value is None or not np.isfinite(value):
            assert far == 0


def test_one_session_that_differs_stands_out_alone() -> None:
    z = robust_z([1.0, 1.1, 0.9, 1.05, 0.95, 9.0])
    assert z[-1] > 20
    assert abs(z[:-1]).max() < 2
    assert (robust_z([1.0, 1.0, 1.0, 9.0]) == 0).all()
