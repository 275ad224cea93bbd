"""Keys are heard one by one, and the terminal is as it was on every way out."""

import contextlib
import os
import pty
import queue
import termios

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.operator.keys import has_keys, heard, key_by_key, pressed


@pytest.fixture
def terminal():
    ours, theirs = pty.openpty()
    yield ours, theirs
    with contextlib.suppress(OSError):
        os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize(
    ("piece", "key"),
    [
        (b"r", "r"),
        (b"R", "r"),
        (b"rrr", "r"),
        (b"\x1b[A", "up"),
        (b"\x1bOB", "down"),
        (b"\x1b[A\x1b[B", None),
        (b"\x1bOP", None),
        (b"\x1b[15~", None),
        (b"\x1b", None),
        (b"accept this", None),
        (b"ra", None),
        (b"please quit", "q"),
        (b"aq", "q"),
        (b"\x03", "q"),
        (b"\x1a\x1c\x13p", "p"),
        (b"\x1ba", None),
        ("é".encode(), "é"),
        (b"\xff", "\ufffd"),
        (b"", None),
    ],
)
def test_a_key_is_what_was_meant_and_nothing_is_accepted_by_accident(piece, key):
    assert pressed(piece) == key


@given(st.binary(max_size=60))
def test_any_bytes_are_one_key_or_none(piece):
    key = pressed(piece)
    assert key is None or len(key) == 1 or key in ("up", "down")
    if b"q" in piece and b"\x1b" not in piece:
        assert key == "q"


def test_keys_come_at_once_and_are_not_shown(terminal):
    ours, theirs = terminal
    keys = queue.Queue()
    with key_by_key(theirs), heard(theirs, keys.put):
        for key in "rpc":
            os.write(ours, key.encode())
            assert keys.get(timeout=30) == key  # without a return
        os.set_blocking(ours, False)
        with pytest.raises(BlockingIOError):
            os.read(ours, 100)


def test_the_terminal_is_as_it_was_after_the_block_and_after_an_exception(terminal):
    _, theirs = terminal
    before = termios.tcgetattr(theirs)
    with key_by_key(theirs):
        inside = termios.tcgetattr(theirs)
        assert not inside[3] & termios.ICANON
        assert not inside[3] & termios.ECHO
        assert inside[3] & termios.ISIG  # Ctrl-C is a signal still
        assert inside[6][termios.VINTR] == before[6][termios.VINTR]
        assert inside[6][termios.VSUSP] == inside[6][termios.VQUIT] == b"\0"
    assert termios.tcgetattr(theirs) == before
    with pytest.raises(KeyboardInterrupt), key_by_key(theirs):
        raise KeyboardInterrupt
    assert termios.tcgetattr(theirs) == before


def test_a_terminal_that_goes_away_harms_nothing(terminal):
    ours, theirs = terminal
    keys = queue.Queue()
    with key_by_key(theirs), heard(theirs, keys.put):
        os.write(ours, b"r")
        assert keys.get(timeout=30) == "r"
        os.close(ours)
    assert keys.empty()


def test_a_pipe_has_no_keys(terminal):
    reader, writer = os.pipe()
    assert not has_keys(reader)
    os.close(reader)
    os.close(writer)
    assert not has_keys(reader)
    assert not has_keys(terminal[1])  # a terminal, but not the one of this process
