"""Single keys from a terminal, heard at once and in a thread of their own."""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import select
import termios
import threading
from collections.abc import Callable, Iterator

ESCAPES = re.compile(rb"\x1b(?:\[[0-?]*[ -/]*[@-~]|O.|.)?", re.DOTALL)
"""What arrow keys and the like send; its letters are not keys."""
ARROWS = {b"\x1b[A": "up", b"\x1bOA": "up", b"\x1b[B": "down", b"\x1bOB": "down"}
"""They scroll, and do nothing else."""


def pressed(piece: bytes) -> str | None:
    """The key that was meant by what a terminal sent at once; None for none.

    A paste or several keys at once mean nothing, except that a q among them stops: nobody shall
    accept a photograph by accident, and stopping loses nothing.

    Args:
        piece: bytes as they were read.
    """
    arrows = {ARROWS.get(found) for found in ESCAPES.findall(piece)}
    if len(arrows) == 1 and not ESCAPES.sub(b"", piece):
        return arrows.pop()
    text = ESCAPES.sub(b"", piece).decode(errors="replace").lower()
    if "q" in text or "\x03" in text:
        return "q"
    letters = {letter for letter in text if letter.isprintable()}
    return letters.pop() if len(letters) == 1 else None


def has_keys(handle: int) -> bool:
    """Whether this is a terminal whose keys come to this process (not a job in its background)."""
    try:
        return os.isatty(handle) and os.tcgetpgrp(handle) == os.getpgrp()
    except OSError:
        return False


@contextlib.contextmanager
def key_by_key(handle: int) -> Iterator[None]:
    """A terminal that gives each key at once and does not show it; as it was on every way out.

    Ctrl-C stays a signal, which works whatever this program does. Ctrl-Z, Ctrl-backslash and Ctrl-S
    are switched off: a capture must not stand still, or end without its last words, with lights on.

    Args:
        handle: file descriptor of a terminal.
    """
    before = termios.tcgetattr(handle)

    def restore() -> None:
        with contextlib.suppress(OSError, termios.error):  # the terminal may be closed
            termios.tcsetattr(handle, termios.TCSANOW, before)

    mode = termios.tcgetattr(handle)
    mode[0] &= ~termios.IXON
    mode[3] &= ~(termios.ICANON | termios.ECHO)
    mode[3] |= termios.ISIG
    off = os.fpathconf(handle, "PC_VDISABLE")
    mode[6] = [*mode[6]]
    mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
    mode[6][termios.VSUSP] = mode[6][termios.VQUIT] = bytes([off])
    atexit.register(restore)
    try:
        termios.tcsetattr(handle, termios.TCSANOW, mode)
        yield
    finally:
        restore()
        atexit.unregister(restore)


@contextlib.contextmanager
def heard(handle: int, press: Callable[[str], None]) -> Iterator[None]:
    """Call `press` with each key, from a thread, as long as the block lasts.

    Args:
        handle: file descriptor, such as of a terminal; read only here.
        press: called with a letter in lower case, ``up`` or ``down``.
    """
    woken, waker = os.pipe()

    def listen() -> None:
        while True:
            ready, _, _ = select.select([handle, woken], [], [])
            if woken in ready:
                return
            try:
                piece = os.read(handle, 1024)
            except OSError:
                piece = b""
            if not piece:  # the terminal is closed; a signal (SIGHUP) reports it to the capture
                return
            key = pressed(piece)
            if key is not None:
                press(key)

    thread = threading.Thread(target=listen, name="keys", daemon=True)
    thread.start()
    try:
        yield
    finally:
        os.write(waker, b"!")
        thread.join()
        os.close(woken)
        os.close(waker)
