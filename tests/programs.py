"""The project's commands in the tests' own process: nothing is imported or compiled again."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from lightstage.commands import run_app

LONGEST_S = 400.0
"""A command that takes longer, compiling included, hangs: it is interrupted, so that its test fails
and tells which."""
_build = typer.main.get_command
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str


def run_program(program: str, *words: Any, interrupt_s: float = LONGEST_S) -> Ended:
    """Run a program in this process: `run_program("sim", "render", ...)`.

    Args:
        program: the package.
        words: the command line behind the program's name.
        interrupt_s: it gets Ctrl-C after so many seconds.
    """
    app = importlib.import_module(f"{program}.__main__").app
    return run_here(app, f"lightstage-{program}", *words, interrupt_s=interrupt_s)


def run_here(app: typer.Typer, *argv: Any, interrupt_s: float = LONGEST_S) -> Ended:
    """The same of any app, whose command line is given whole."""
    out, err = _text(), _text()
    with pytest.MonkeyPatch.context() as patch, _interrupted_after(interrupt_s):
        patch.setattr(sys, "argv", [str(word) for word in argv])
        patch.setattr(typer.main, "get_command", _built_once)
        redirected = contextlib.redirect_stdout(out), contextlib.redirect_stderr(err)
        with redirected[0], redirected[1], pytest.raises(SystemExit) as ended:
            run_app(app)
    code = ended.value.code
    return Ended(code if isinstance(code, int) else 0, _said(out), _said(err))


@functools.cache
def _built_once(app: typer.Typer) -> Any:
    """A program's commands and options: a process needs them once, the tests a thousand times."""
    return _build(app)


@contextlib.contextmanager
def _interrupted_after(seconds: float) -> Iterator[None]:
    """Ctrl-C at its time; every handler is as it was before, for a command that was interrupted
    ignores what comes after, because its process ends."""

    def ctrl_c(*_: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    before = {number: signal.getsignal(number) for number in STOPPING}
    before[signal.SIGALRM] = signal.signal(signal.SIGALRM, ctrl_c)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _text() -> io.TextIOWrapper:
    """A stream that is no terminal and has bytes underneath, as a pipe has."""
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="", write_through=True)


def _said(stream: io.TextIOWrapper) -> str:
    assert isinstance(stream.buffer, io.BytesIO)
    return stream.buffer.getvalue().decode()
