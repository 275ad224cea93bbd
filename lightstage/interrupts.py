"""Ctrl-C, SIGTERM and a closed terminal: each ends a command in order, whenever it comes."""

from __future__ import annotations

import signal
import threading

_interrupted = threading.Event()


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


def _interrupt(*_: object) -> None:
    _interrupted.set()
    raise KeyboardInterrupt
