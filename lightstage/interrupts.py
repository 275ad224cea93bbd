"""Ctrl-C, SIGTERM and a closed terminal: each ends a command in order, whenever it comes."""

from __future__ import annotations

import contextlib
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_interrupted = threading.Event()
_once = threading.Event()
AGAIN_S = 1.0
"""A second signal this long after a noted one is somebody who will not wait: it interrupts.
One key may reach a process several times, from the terminal and from who started it."""


class Noted:
    """Whether a signal has come within `first_signal_noted`, and when."""

    came: bool = False
    since: float = 0.0


_noting: list[Noted] = []


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
    _once.clear()
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL):
        signal.signal(signal.SIGINT, _interrupt)


def raise_once() -> None:
    """From now on the first signal alone is a KeyboardInterrupt; later ones change nothing.

    For a process that lights lamps: what the first Ctrl-C sets going (dark, photographs brought
    home, last words) takes seconds, and a second Ctrl-C must not cut it short.

    Raises:
        KeyboardInterrupt: a signal came before, and was lost in a library.
    """
    _once.set()
    if interrupted():
        raise KeyboardInterrupt


@contextlib.contextmanager
def handlers_kept() -> Iterator[None]:
    """Put Python's handlers back after a block whose libraries may set some beneath them.

    Only the main thread may set a handler; another one leaves what the libraries set.
    """
    before = {number: signal.getsignal(number) for number in NUMBERS}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                if handler is not None:  # None: not Python's, and so not known here
                    signal.signal(number, handler)


def interrupted() -> bool:
    """Whether a signal has come.

    An exception that a signal raises inside a library's callback is lost there; who asks here
    can raise it again.
    """
    return _interrupted.is_set()


def ignore_signals() -> None:
    """For a process that has printed its last line: its exit code must stay what it is."""
    for number in NUMBERS:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def signals_put_off() -> Iterator[None]:
    """Put off every SIGINT, SIGTERM and SIGHUP to the block's end, when they interrupt as usual.

    For seconds that nothing may cut short: a second Ctrl-C must not leave the lights on. Where the
    block fails, its error ends the command already. Work that is to end itself early when a signal
    comes asks `first_signal_noted`. Only the main thread gets signals at all.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = [signal.signal(number, lambda got, _: held.append(got)) for number in NUMBERS]
    try:
        yield
    finally:
        for number, handler in zip(NUMBERS, before, strict=True):
            signal.signal(number, handler)
    for came in dict.fromkeys(held):
        signal.raise_signal(came)


@contextlib.contextmanager
def on_signals(notify: Callable[[], object]) -> Iterator[None]:
    """Call `notify` when a signal comes, from a thread of its own: whatever the main one does.

    The main thread hears a signal only when what it waits for, or computes in C, is over.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard, waker = socket.socketpair()
    waker.setblocking(False)

    def listen() -> None:
        while numbers := heard.recv(64):
            if any(number in NUMBERS for number in numbers):
                notify()

    before = signal.set_wakeup_fd(waker.fileno(), warn_on_full_buffer=False)
    thread = threading.Thread(target=listen, name="signals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        waker.close()
        thread.join()
        heard.close()


@contextlib.contextmanager
def first_signal_noted() -> Iterator[Noted]:
    """Record the first signal without an interrupt. Code that polls `came` ends by itself.

    For long work whose parts belong together, such as a training's steps. A second signal, later
    than `AGAIN_S` after the first, raises KeyboardInterrupt at once.
    """
    here = Noted()
    _noting.append(here)
    try:
        yield here
    finally:
        _noting.remove(here)


def _interrupt(*_: object) -> None:
    again = _interrupted.is_set()
    _interrupted.set()
    if again and _once.is_set():
        return
    now = time.monotonic()
    if _noting and (not _noting[-1].came or now - _noting[-1].since < AGAIN_S):
        if not _noting[-1].came:
            _noting[-1].came, _noting[-1].since = True, now
        return
    raise KeyboardInterrupt
