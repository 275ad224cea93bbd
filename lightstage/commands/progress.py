"""The progress bar of a command."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from lightstage.interrupts import interrupted

LINE_EVERY_S = 30.0
"""A log file gets a line of how far the work is so often."""
ProgressCallback = Callable[[int, int], None]
"""`progress(done, total)`, called by long functions; they print nothing themselves."""


def quiet(done: int, total: int) -> None:
    """A progress callback that shows nothing."""


@contextlib.contextmanager
def progress_bar(label: str) -> Iterator[ProgressCallback]:
    """A bar on stderr, drawn from `progress(done, total)` calls.

    In a log file it is plain lines: that the work has begun, how far it is every half minute, and
    when it ended.
    The yielded callback raises KeyboardInterrupt where a signal came before.
    """
    if not sys.stderr.isatty():
        with _by_lines(label) as progress:
            yield progress
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeLeft())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=None)

        def progress(done: int, total: int) -> None:
            _stop_where_interrupted(done, total)
            bar.update(task, completed=done, total=total)

        yield progress


@contextlib.contextmanager
def _by_lines(label: str) -> Iterator[ProgressCallback]:
    began, how = time.monotonic(), "stopped after"
    shown_s = began

    def progress(done: int, total: int) -> None:
        nonlocal shown_s
        _stop_where_interrupted(done, total)
        now = time.monotonic()
        if now - shown_s >= LINE_EVERY_S:
            shown_s = now
            print(f"{label}: {done} of {total}", file=sys.stderr, flush=True)

    print(f"{label}: begun", file=sys.stderr, flush=True)
    try:
        yield progress
        how = "done in"
    finally:
        print(f"{label}: {how} {time.monotonic() - began:.1f} s", file=sys.stderr, flush=True)


def _stop_where_interrupted(*_: int) -> None:
    """A ProgressCallback that only stops."""
    if interrupted():
        raise KeyboardInterrupt
