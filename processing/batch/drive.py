"""The sessions of a batch from stage to stage: who works on what, and what is tried again."""

from __future__ import annotations

import dataclasses
import itertools
import queue
import time
from collections.abc import Callable
from typing import Any, Literal

import distributed

from lightstage.counting import counted
from processing.batch.cluster import GONE, Workers
from processing.batch.config import BatchConfig
from processing.batch.needs import SECONDS, between
from processing.batch.work import Answer, Order, look, step

LOOK_S = 0.5
"""The batch checks so often for what no event reports."""
SLOTS_S = 2.0
BUSY_AGAIN_S = 2.0
"""The batch tries a folder that another run holds again after so long."""
State = Literal["waiting", "done", "failed"]


@dataclasses.dataclass
class Item:
    """One session of a batch.

    Attributes:
        order: what workers receive.
        session_id: its id, the name of its folder in the batch's.
        subject: the person's pseudonym.
        expression: such as ``neutral``.
        size_mp: megapixels of a photograph.
        state: `waiting` until it is done or has failed.
        left: stages that are not up to date; None until they are known.
        ran: stages that this batch ran.
        verified: whether this batch held its photographs against their hashes.
        tries: how often the stage that is next was begun and given up.
        busy_since: when its folder was first found held by another run.
        not_before: when it may be tried again.
        facts: of the stages that are done.
        reason: why it failed, or was last given up.
    """

    order: Order
    session_id: str
    subject: str
    expression: str
    size_mp: float
    state: State = "waiting"
    left: tuple[str, ...] | None = None
    ran: list[str] = dataclasses.field(default_factory=list)
    verified: bool = False
    tries: int = 0
    busy_since: float | None = None
    not_before: float = 0.0
    facts: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    reason: str = ""
    trace: str = ""

    @property
    def begun(self) -> bool:
        """Whether a stage ran and others are left: it goes before those that have not begun."""
        return bool(self.ran)


@dataclasses.dataclass
class Running:
    """A task that a worker has, or will get."""

    item: Item
    future: distributed.Future
    since: float
    worker: str | None = None


@dataclasses.dataclass(frozen=True)
class Left:
    """How far a batch is."""

    sessions: int
    done: int
    failed: int
    stages_done: int
    stages: int
    seconds_left: float | None


class Batch:
    """Sessions, workers, and what happens between them; `run` returns when nothing is left."""

    def __init__(
        self,
        items: list[Item],
        workers: Workers,
        config: BatchConfig,
        show: Callable[[Batch], None] = lambda _: None,
    ) -> None:
        """`show` is called twice a second, for progress and the page."""
        self.items = items
        self.config = config
        self.full: str | None = None
        self.gone: str | None = None
        self._workers = workers
        self._show = show
        self._running: dict[str, Running] = {}
        self._numbers = itertools.count()
        self._slots: dict[str, int] = {}
        self._slots_at = float("-inf")
        self._away_since: float | None = None
        self._unfit: dict[str, str] = {}
        self._unfit_since: float | None = None
        self._seconds: dict[str, list[float]] = {}

    def run(self) -> None:
        """Work until every session is done or has failed, or nothing more can be done.

        A full disk, a scheduler that stays away, and workers of which none fits end it: no new
        stage is begun.
        """
        try:
            while self._open():
                self._look_after()
                self._begin()
                self._hear()
                self._show(self)
        except BaseException:
            running = [each.future for each in self._running.values()]
            self._workers.stop(self.items[0].order.batch, running)
            raise

    def left(self) -> Left:
        """How far the batch is, and how long it takes yet."""
        done = sum(item.state == "done" for item in self.items)
        failed = sum(item.state == "failed" for item in self.items)
        looked = [item for item in self.items if item.left is not None]
        waiting = sum(len(i.left or ()) for i in looked if i.state == "waiting")
        ran = sum(len(item.ran) for item in self.items)
        seconds: float | None = None
        if len(looked) == len(self.items):
            each = [
                self._expected(stage, item)
                for item in looked
                if item.state == "waiting"
                for stage in item.left or ()
            ]
            seconds = sum(each) / max(1, len(self._slots))
        return Left(len(self.items), done, failed, ran, ran + waiting, seconds)

    def _expected(self, stage: str, item: Item) -> float:
        """Seconds of a stage: the mean of those that this batch ran, else of the table."""
        own = self._seconds.get(stage)
        return sum(own) / len(own) if own else between(SECONDS, stage, item.size_mp)

    def _open(self) -> bool:
        if self._running:
            return True
        ended = self.full is not None or self.gone is not None
        return not ended and any(item.state == "waiting" for item in self.items)

    def _begin(self) -> None:
        """Give every free worker a stage: of sessions that have begun first."""
        if self.full is not None or self._away_since is not None:
            return
        fit = [name for name in self._slots if name not in self._unfit]
        busy = {id(running.item) for running in self._running.values()}
        now = time.monotonic()
        ready = [
            item
            for item in self.items
            if item.state == "waiting" and id(item) not in busy and item.not_before <= now
        ]
        # All are checked first: only then is the time that is left known.
        ready.sort(key=lambda item: (item.left is not None, not item.begun))
        for item in ready[: max(0, len(fit) - len(self._running))]:
            name = f"{item.order.batch}-{next(self._numbers)}"
            words = (
                (look, item.order) if item.left is None else (step, item.order, not item.verified)
            )
            on = fit if self._unfit else None
            try:
                future = self._workers.submit(name, *words, on=on)
            except GONE:
                return
            self._running[name] = Running(item, future, now)

    def _hear(self) -> None:
        """Wait for the next event, and take in all that have come."""
        try:
            event = self._workers.events.get(timeout=LOOK_S)
        except queue.Empty:
            return
        while True:
            if event["kind"] == "ended":
                running = self._running.pop(event["name"], None)
                if running is not None:
                    self._ended(running)
            else:
                self._progressed(event)
            try:
                event = self._workers.events.get_nowait()
            except queue.Empty:
                return

    def _progressed(self, event: dict[str, Any]) -> None:
        for running in self._running.values():
            if running.item.order.out == event["out"]:
                running.since, running.worker = time.monotonic(), event["worker"]

    def _ended(self, running: Running) -> None:
        item, future = running.item, running.future
        if future.status == "finished":
            self._answered(item, future.result())
        elif future.status == "error":
            error = future.exception()
            if isinstance(error, distributed.KilledWorker):
                self._again(item, "its worker died (killed, or out of memory)")
            else:
                self._again(item, f"{type(error).__name__}: {str(error)[:400]}")
        else:
            # Cancelled, or lost with the scheduler: its state is not known, so it is checked.
            item.left = None

    def _answered(self, item: Item, answer: Answer) -> None:
        now = time.monotonic()
        item.facts = answer.facts or item.facts
        if answer.status == "done":
            item.left, item.tries, item.busy_since, item.reason = answer.left, 0, None, ""
            if answer.ran is not None:
                item.ran.append(answer.ran)
                item.verified = True
                self._seconds.setdefault(answer.ran, []).append(
                    float(answer.facts.get(answer.ran, {}).get("seconds", 0.0))
                )
            if not answer.left and answer.reported:
                item.state = "done"
        elif answer.status == "busy":
            item.busy_since = item.busy_since or now
            item.not_before = now + BUSY_AGAIN_S
            if now - item.busy_since >= self.config.busy_s:
                self._fail(item, answer.reason)
        elif answer.status == "again":
            self._again(item, answer.reason)
        elif answer.status == "unfit":
            # It was not begun there: another worker may take it, and it has lost no try.
            self._unfit[answer.worker] = item.reason = answer.reason
        elif answer.status == "disk full":
            self.full = answer.reason
            item.reason = answer.reason
        elif answer.status == "stopped":
            item.left = None
        else:
            self._fail(item, answer.reason, answer.trace)

    def _again(self, item: Item, reason: str) -> None:
        item.tries += 1
        item.reason = reason
        # A killed worker's folder may hold half of a stage: what is left is checked anew.
        stage = item.left[0] if item.left else "the first check"
        if item.tries >= self.config.tries:
            message = f"{stage} was begun {counted(item.tries, 'time')}, the last time: {reason}"
            self._fail(item, message)

    def _fail(self, item: Item, reason: str, trace: str = "") -> None:
        item.state, item.reason, item.trace = "failed", reason, trace

    def _look_after(self) -> None:
        """See which workers there are, whether one hangs, and whether the scheduler answers."""
        now = time.monotonic()
        if self._workers.alive() and self._away_since is None:
            if now - self._slots_at >= SLOTS_S:
                try:
                    self._slots, self._slots_at = self._workers.slots(), now
                except GONE:
                    self._went_away(now)
                    return
            self._look_for_hung(now)
            self._look_for_lost()
            self._look_for_fit(now)
        else:
            self._went_away(now)

    def _look_for_hung(self, now: float) -> None:
        for name, running in list(self._running.items()):
            if now - running.since < self.config.stalled_s:
                continue
            # Stages that wait for a worker have reported no progress yet, and do not hang.
            if running.worker is None and len(self._slots) == 0:
                continue
            del self._running[name]
            running.future.cancel()
            if running.worker is not None:
                self._workers.restart(running.worker)
                self._slots_at = float("-inf")
            self._again(
                running.item, f"it reported no progress for {self.config.stalled_s:g} s: killed"
            )

    def _look_for_lost(self) -> None:
        for name, running in list(self._running.items()):
            if running.future.status in ("lost", "cancelled"):
                del self._running[name]
                running.item.left = None

    def _look_for_fit(self, now: float) -> None:
        """End where no worker of this version has been there for as long as a scheduler may be."""
        if self._running or not self._slots or self._slots.keys() - self._unfit.keys():
            self._unfit_since = None
            return
        self._unfit_since = self._unfit_since or now
        if now - self._unfit_since >= self.config.away_s:
            reason = next(self._unfit[name] for name in self._slots)
            self.gone = f"no worker that fits came within {self.config.away_s:g} s: {reason}"

    def _went_away(self, now: float) -> None:
        """The scheduler does not answer: wait for it, then check all sessions again."""
        if self._away_since is None:
            self._away_since = now
        if self._workers.again():
            for running in self._running.values():
                running.item.left = None
            self._running.clear()
            self._away_since, self._slots_at = None, float("-inf")
        elif now - self._away_since >= self.config.away_s:
            self.gone = (
                f"the scheduler at {self._workers.address} was gone for {self.config.away_s:g} s"
            )
            self._running.clear()
