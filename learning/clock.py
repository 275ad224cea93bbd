"""What a training's time goes into: making data, rendering, the network, and waiting."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import defaultdict
from collections.abc import Iterator

PARTS = DATA, RENDERING, NETWORK, IDLE = "data", "rendering", "network", "idle"
"""Making a batch less rendering it; rendering, in batches and in losses; everything else of a step,
the backward pass of a rendering loss too; what a step waits for its batch, whoever makes it."""


class Clock:
    """Seconds by part; a part within another one counts as the inner one alone.

    A step is a `NETWORK` part. Other parts count while a step runs, in this thread or another one:
    what is read before the first step, scored after the last one or made ahead for none is no part
    of the steps' time. Threads may share a clock. A GPU works on while a part ends: work that one
    part starts can count in the next part, which waits for it, which is the network's.
    """

    def __init__(self) -> None:
        """Nothing is measured yet."""
        self.seconds: dict[str, float] = defaultdict(float)
        self._whole: dict[str, float] = defaultdict(float)
        self.first_seconds = 0.0
        """Of the first step, which compiles loops; 0 until it is done."""
        self._lock, self._own = threading.Lock(), threading.local()
        self._running, self._looked, self._steps = 0, 0.0, 0.0

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the block's time as a part's, as far as a step runs meanwhile."""
        stack: list[float] = self._own.__dict__.setdefault("inner", [])
        stack.append(0.0)
        step = int(name == NETWORK)
        began = self._stepped(step)
        try:
            yield
        finally:
            spent = self._stepped(-step) - began
            inner = stack.pop()
            if stack:
                stack[-1] += spent
            with self._lock:
                self.seconds[name] += spent - inner
                self._whole[name] += spent

    def _stepped(self, change: int) -> float:
        """Seconds in which a step ran until now; `change` is how many more run from now on."""
        with self._lock:
            now = time.perf_counter()
            if self._running:
                self._steps += now - self._looked
            self._looked, self._running = now, self._running + change
            return self._steps

    @property
    def step_seconds(self) -> float:
        """What the steps took in all."""
        return self._whole[NETWORK]

    def shares(self) -> dict[str, float]:
        """Each part's share of the steps' time; nothing where there was no step.

        Batches that are made meanwhile in another thread come on top of a step's own parts.
        """
        steps = self.step_seconds
        if not steps > 0:
            return {}
        shares = {name: self.seconds[name] / steps for name in (DATA, RENDERING, NETWORK)}
        return {**shares, IDLE: self._whole[IDLE] / steps}
