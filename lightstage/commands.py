"""What every command shares: exit codes, progress bars, the one line of facts."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from lightstage.errors import LightstageError

ProgressCallback = Callable[[int, int], None]
"""`progress(done, total)`, called by long functions; they print nothing themselves."""

JsonFlag = typer.Option(False, "--json", help="Print the facts as JSON on the last line.")


_interrupted = threading.Event()


def quiet(done: int, total: int) -> None:
    """A progress callback that shows nothing."""


def make_app(help_text: str) -> typer.Typer:
    """A Typer application with this project's settings."""
    return typer.Typer(
        help=help_text, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
    )


def run_app(app: typer.Typer) -> None:
    """Run an application: 0 done, 2 on arguments or input that the user can mend.

    SIGTERM and SIGHUP (a closed terminal) are turned into KeyboardInterrupt, so that every
    `finally` (lights dark, temporary files removed) runs for them as for Ctrl-C. An exception that
    a signal raises inside a library's callback is lost there; the next `progress` call raises it
    again.
    """

    def interrupt(*_: object) -> None:
        _interrupted.set()
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGHUP, interrupt)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored
        signal.signal(signal.SIGINT, interrupt)
    try:
        app()
    except LightstageError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        sys.exit(2)


@contextlib.contextmanager
def progress_bar(label: str) -> Iterator[ProgressCallback]:
    """A bar on stderr, drawn from `progress(done, total)` calls."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    off = not console.is_terminal  # a log file wants the last line only
    with Progress(*columns, console=console, transient=True, disable=off) as bar:
        task = bar.add_task(label, total=None)

        def progress(done: int, total: int) -> None:
            if _interrupted.is_set():
                raise KeyboardInterrupt
            bar.update(task, completed=done, total=total)

        yield progress


def finish(text: str, facts: dict[str, Any], as_json: bool) -> None:
    """End a command: one line of facts with units, or the same facts as JSON."""
    print(json.dumps(facts) if as_json else text)
