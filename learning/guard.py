"""A training's guard: whether a loss leapt, at its first step or later, and stays high."""

from __future__ import annotations

import collections
import math
import statistics

BEGINNING = 4
"""Steps whose mean is the loss before the training."""
WINDOW = 50
"""Steps whose mean is compared: one batch may be five times as hard as the next."""
LEAP = 5.0
"""Ratio to the lowest mean so far that no noise of batches has: theirs was at most 2.7."""
LEAP_FROM_FIRST = 12.0
"""Ratio to the first step's loss alone. A rate that is far too high spoils all steps but that one,
which a network of whole faces begins with the mean person: 14 at 250 times its rate."""


class Guard:
    """Compares the mean of the last steps with the lowest there was, and with the first step."""

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._last: collections.deque[float] = collections.deque(maxlen=WINDOW)
        self._lowest = self._first = math.inf

    def leapt(self, loss: float) -> bool:
        """Take one step's loss; whether the loss has leapt and stays high."""
        if self._first == math.inf:
            self._first = loss
        self._last.append(loss)
        if len(self._last) not in (BEGINNING, WINDOW):
            return False
        mean = statistics.fmean(self._last)
        self._lowest = min(self._lowest, mean)
        whole = len(self._last) == WINDOW
        return mean > LEAP * self._lowest or (whole and mean > LEAP_FROM_FIRST * self._first)
