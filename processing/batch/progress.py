"""How far a batch is, on a terminal or in a log."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from lightstage.commands.progress import LINE_EVERY_S
from processing.batch.drive import Left


def duration(seconds: float) -> str:
    """Seconds in the unit that suits them: ``40 s``, ``12 min``, ``3.5 h``, ``9.7 days``."""
    for unit, length in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.0f} s"


def left_in_words(left: Left) -> str:
    """How far a batch is, in one line."""
    text = f"{left.done} of {left.sessions} sessions, {left.stages_done} of {left.stages} stages"
    if left.failed:
        text += f", {left.failed} failed"
    if left.seconds_left is None:
        return f"{text}; checking what is to be done"
    return f"{text}, {duration(left.seconds_left)} left" if left.seconds_left else text


@contextlib.contextmanager
def shown() -> Iterator[Callable[[Left], None]]:
    """Yield what shows how far a batch is, on stderr."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console

    console = Console(stderr=True)
    with console.status("batch") as status:
        yield lambda left: status.update(f"batch: {left_in_words(left)}")


def _lines() -> Callable[[Left], None]:
    shown_s, last = float("-inf"), ""

    def show(left: Left) -> None:
        nonlocal shown_s, last
        text, now = left_in_words(left), time.monotonic()
        whole = left.done + left.failed == left.sessions
        if text != last and (whole or now - shown_s >= LINE_EVERY_S):
            shown_s, last = now, text
            print(f"batch: {text}", file=sys.stderr, flush=True)

    return show
