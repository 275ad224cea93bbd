"""A step's time by part, and batches that are made ahead."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from learning import clock as clocks
from learning.clock import DATA, IDLE, NETWORK, RENDERING, Clock
from learning.loader import Ahead, threads_may_render


def test_a_part_within_another_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 1.0, 2.0, 3.0, 7.0, 8.0, 9.0, 18.0])
    monkeypatch.setattr(clocks.time, "perf_counter", lambda: next(now))
    clock = Clock()
    assert clock.shares() == {}
    # 0 to 18, 1 to 9, 2 to 8, 3 to 7.
    with clock.part(NETWORK), clock.part(IDLE), clock.part(DATA), clock.part(RENDERING):
        pass
    assert dict(clock.seconds) == {RENDERING: 4.0, DATA: 2.0, IDLE: 2.0, NETWORK: 10.0}
    expected = {DATA: 2 / 18, RENDERING: 4 / 18, NETWORK: 10 / 18, IDLE: 8 / 18}
    assert clock.shares() == pytest.approx(expected)


def test_what_is_made_while_no_step_runs_has_no_share(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 5.0, 5.0, 6.0, 7.0, 8.0, 10.0, 10.0, 12.0, 18.0])
    monkeypatch.setattr(clocks.time, "perf_counter", lambda: next(now))
    clock = Clock()
    with clock.part(RENDERING):  # 0 to 5: what the data are made of
        pass
    ahead, other = clock.part(DATA), ThreadPoolExecutor(1)
    with clock.part(NETWORK):  # 5 to 10
        with clock.part(IDLE):  # 6 to 7
            pass
        other.submit(ahead.__enter__).result()  # from 8: of the step after the last one
    with clock.part(RENDERING):  # 10 to 12: scores
        pass
    other.submit(ahead.__exit__, None, None, None).result()  # to 18
    other.shutdown()
    assert clock.shares() == {DATA: 0.4, RENDERING: 0.0, NETWORK: 0.8, IDLE: 0.2}


def test_threads_count_their_own_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, inside, done = Clock(), threading.Event(), threading.Event()

    def other() -> None:
        with clock.part(DATA):
            inside.set()
            done.wait(5)

    thread = threading.Thread(target=other)
    with clock.part(NETWORK):
        thread.start()
        inside.wait(5)
        time.sleep(0.02)
    done.set()
    thread.join()
    assert clock.seconds[NETWORK] > 0.01
    assert clock.seconds[DATA] > 0.01


def test_a_batch_follows_from_its_number_however_it_was_made() -> None:
    made: list[tuple[int, str]] = []

    def make(number: int) -> int:
        made.append((number, threading.current_thread().name))
        return 10 * number

    with Ahead(make) as batches:
        assert [batches.get(n) for n in (3, 4, 5)] == [30, 40, 50]
        assert batches.get(9) == 90
        assert batches.aside(make, 2) == 20
    numbers = [number for number, _ in made]
    assert set(numbers) >= {2, 3, 4, 5, 9}
    assert len(numbers) <= 7
    assert all(name.startswith("batches") for _, name in made)


@pytest.mark.parametrize(("layer", "may"), [("omp", True), ("tbb", True), ("workqueue", False)])
def test_two_threads_render_where_numba_lets_them(
    layer: str, may: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("numba.threading_layer", lambda: layer)
    assert threads_may_render() == may

    def unknown() -> None:
        raise ValueError("Threading layer is not initialized.")

    monkeypatch.setattr("numba.threading_layer", unknown)
    assert not threads_may_render()


def test_what_goes_wrong_ahead_is_raised_at_its_step() -> None:
    def make(number: int) -> int:
        if number == 2:
            raise ValueError("no such face")
        return number

    with Ahead(make) as batches:
        assert batches.get(1) == 1
        with pytest.raises(ValueError, match="no such face"):
            batches.get(2)
