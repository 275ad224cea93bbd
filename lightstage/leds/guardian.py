"""A process that outlives a killed capture long enough to put its lights out.

Run as a script with nothing but the standard library, so that it is there in a few hundredths of
a second: `python -I -S guardian.py`, as lightstage/leds/guard.py does. Its standard input is a pipe
from the capture: one line of JSON (what to send, on which of the inherited handles), then `.` for
"still there", and `!` for "all is well, go". When the pipe ends without that, because the capture
was killed, or hangs too long, it sends what makes the device dark and ends.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time
from typing import Any

ANSWER_WAIT_S = 0.25
PAUSE_S = 0.03
HEAD_END = b"\r\n\r\n"
"""Ends the HTTP header before a connection is a WebSocket."""


def main() -> int:
    """Wait until the capture ends.

    Returns:
        0 when the capture had ended in order, had lit nothing yet, or the lights are dark; 1 when
        that is not certain.
    """
    # The terminal's Ctrl-C and a service's stop are the capture's matter.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    pending = b""
    while b"\n" not in pending:
        data = os.read(0, 65536)
        if not data:
            return 0  # nothing was lit yet
        pending += data
    head, _, received = pending.partition(b"\n")
    will = json.loads(head)
    with contextlib.suppress(BrokenPipeError):  # killed meanwhile: the lines below notice it
        os.write(1, b"r")
    while b"!" not in received:
        if not select.select([0], [], [], will["silence_s"])[0]:
            break
        received = os.read(0, 65536)
        if not received:
            break
    if b"!" in received:
        return 0
    dark = make_dark_anew(will) if will.get("connect") else make_dark(will)
    return 0 if dark else 1


def make_dark_anew(will: dict[str, Any]) -> bool:
    """Send the last will by connections of its own, until it is answered.

    What the capture sent by its own connection may still be read after that: only a will that is
    answered after the device has closed the capture's connection is the last word.
    """
    messages = b"".join(bytes.fromhex(text) for text, _ in will["messages"])
    greeting, answer = bytes.fromhex(will["greeting"]), bytes.fromhex(will["answer"])
    until = time.monotonic() + will["patience_s"]
    read_to_its_end = False
    while time.monotonic() < until:
        read_to_its_end = read_to_its_end or ended(will["handle"])
        try:
            left_s = max(1e-3, until - time.monotonic())
            with socket.create_connection(tuple(will["connect"]), left_s) as line:
                line.sendall(greeting)
                heard = hear(line, b"", HEAD_END, until)
                line.sendall(messages)
                hear(line, heard, answer, until)
        except OSError:
            time.sleep(PAUSE_S)
            continue
        if read_to_its_end:
            return True
    return False


def hear(line: socket.socket, heard: bytes, wanted: bytes, until: float) -> bytes:
    """Read until something was heard; what came after it. OSError where that does not come."""
    while wanted not in heard:
        line.settimeout(max(1e-3, until - time.monotonic()))
        got = line.recv(65536)
        if not got:
            raise ConnectionResetError
        heard = (heard + got)[-65536:]
    return heard.partition(wanted)[2]


def ended(handle: int) -> bool:
    """Announce that the capture's connection ends; whether the device ended it too, in time."""
    line = socket.socket(fileno=os.dup(handle))
    until = time.monotonic() + ANSWER_WAIT_S
    try:
        line.shutdown(socket.SHUT_WR)
        while (left_s := until - time.monotonic()) > 0:
            line.settimeout(left_s)
            if not line.recv(65536):
                return True
    except TimeoutError:
        pass
    except OSError:
        return True  # it is gone already
    finally:
        line.close()
    return False


def make_dark(will: dict[str, Any]) -> bool:
    """Send the last will, until it is answered or was sent often enough."""
    handle = will["handle"]
    messages = [(bytes.fromhex(text), where) for text, where in will["messages"]]
    answer = bytes.fromhex(will["answer"])
    until = time.monotonic() + will["patience_s"]
    heard = b""
    sent = 0
    while time.monotonic() < until:
        try:
            for data, where in messages:
                if where is None:
                    write(handle, data, until)
                else:
                    to_network(handle, data, (where[0], where[1]))
            sent += 1
            if not answer and sent == will["rounds"]:
                return True
            round_until = time.monotonic() + (ANSWER_WAIT_S if answer else PAUSE_S)
            while (left := round_until - time.monotonic()) > 0:
                if not answer:
                    time.sleep(left)
                elif select.select([handle], [], [], left)[0]:
                    got = os.read(handle, 65536)
                    if not got:
                        return False
                    heard = (heard + got)[-65536:]
                    if answer in heard:
                        return True
        except OSError:
            time.sleep(PAUSE_S)
    return False


def write(handle: int, data: bytes, until: float) -> None:
    """Write all, also where the line does not take it at once."""
    while data and time.monotonic() < until:
        try:
            data = data[os.write(handle, data) :]
        except BlockingIOError:
            select.select([], [handle], [], PAUSE_S)


def to_network(handle: int, data: bytes, where: tuple[str, int]) -> None:
    """Send one datagram; the handle stays open."""
    end = socket.socket(fileno=os.dup(handle))
    try:
        end.sendto(data, where)
    finally:
        end.close()


if __name__ == "__main__":
    sys.exit(main())
