"""Ctrl-C, SIGTERM and a closed terminal: each ends a command in order, whenever it comes."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator

_interrupted = threading.Event()
AGAIN_S = 1.0
"""A second signal this long after the first is somebody who will not wait: it is never held back.
One key may reach a process several times, from the terminal and from who started it."""


class Held:
    """Whether a signal has come within `held`, and when."""

    came: bool = False
    since: float = 0.0


_held: list[Held] = []


def end_without_traceback() -> None:
    """Let Ctrl-C end the process by its signal, until `raise_on_signals` is called.

    For the time in which a program only imports: nothing is open yet that had to be closed.
    Where SIGINT is ignored (a job in the background), it stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def raise_on_signals() -> None:
    """Turn SIGINT, SIGTERM and SIGHUP into KeyboardInterrupt.

    So every `finally` (lights dark, temporary files removed) runs for each of them.
    """
    _interrupted.clear()
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL):
        signal.signal(signal.SIGINT, _interrupt)


def interrupted() -> bool:
    """Whether a signal has come.

    An exception that a signal raises inside a library's callback is lost there; who asks here
    can raise it again.
    """
    return _interrupted.is_set()


@contextlib.contextmanager
def held() -> Iterator[Held]:
    """Within the block the first signal interrupts nothing: who asks `came` ends in order.

    For work whose parts belong together, such as a step of a training. A second signal, later than
    `AGAIN_S` after the first, raises KeyboardInterrupt at once.
    """
    here = Held()
    _held.append(here)
    try:
        yield here
    finally:
        _held.remove(here)


def _interrupt(*_: object) -> None:
    _interrupted.set()
    now = time.monotonic()
    if _held and (not _held[-1].came or now - _held[-1].since < AGAIN_S):
        if not _held[-1].came:
            _held[-1].came, _held[-1].since = True, now
        return
    raise KeyboardInterrupt
