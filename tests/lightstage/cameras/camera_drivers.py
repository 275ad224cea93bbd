"""Drivers that misbehave as drivers do: they never answer, hold Python's lock, or end."""

from __future__ import annotations

import ctypes
import os
import sys
import time
from pathlib import Path

from lightstage.cameras.camera import CardFile, Exposure, Summary
from lightstage.cameras.card_file import pieces, write_card_file
from lightstage.errors import DeviceError


class Fine:
    """Does all it is asked, at once; its port is the bytes that it photographs."""

    def __init__(self, port):
        self.port = port

    def open(self):
        return self.summary()

    def summary(self):
        return Summary(serial=self.port, model="Fine")

    def change(self, name, value):
        raise DeviceError(self.port, field=name, found=value, expected="nothing")

    def card(self):
        return (CardFile("/1.RAW", len(self.port) * 1000),)

    def trigger(self, at_s):
        time.sleep(max(0.0, at_s - time.monotonic()))
        now_s = time.monotonic()
        return Exposure(self.card(), now_s, now_s)

    def download(self, _name, path):
        data = self.port.encode() * 1000
        return write_card_file(path, len(data), pieces(memoryview(data)))

    def delete(self, _name):
        pass

    def close(self):
        pass


class Looping(Fine):
    """Never ends its trigger, and works all the time."""

    def trigger(self, _at_s):
        while True:
            pass


class HoldingTheLock(Fine):
    """Hangs in C with Python's lock in its hand, as gphoto2's exit and file_delete may."""

    def delete(self, _name):
        ctypes.PyDLL(None).pause()

    def close(self):
        ctypes.PyDLL(None).pause()


class Deaf(Fine):
    """Starts a child of its own that holds its pipes, and ends; its port names where it tells."""

    def trigger(self, _at_s):
        if os.fork() == 0:
            Path(self.port).write_text(str(os.getpid()))
            time.sleep(60)
        os._exit(3)


class Crashing(Fine):
    """Ends with an error that no driver should raise."""

    def trigger(self, _at_s):
        os.write(1, b"as C libraries print\n")
        raise RuntimeError("a fault in the driver")


class Segfaulting(Fine):
    """Ends as a fault in a C library does."""

    def trigger(self, _at_s):
        ctypes.string_at(0)


HOSTILE = "\x1b[2J\x1b]0;mine\x07\r\n\t\0\u202eeman\udcff\x9b31m\u2028" + "x" * 60_000


class Hostile(Fine):
    """Says what would move a terminal's cursor, in whatever it says; its port chooses where."""

    def summary(self):
        return Summary(serial="1", model=HOSTILE, firmware=HOSTILE, owner="\0" * 40)

    def card(self):
        return (CardFile(f"/{HOSTILE}", 1),)

    def change(self, _name, _value):
        raise DeviceError(HOSTILE, field=HOSTILE, found=HOSTILE, expected=HOSTILE, hint=HOSTILE)

    def delete(self, _name):
        sys.stderr.write(HOSTILE.encode("utf-8", "surrogateescape").decode("utf-8", "replace"))
        sys.stderr.flush()
        os._exit(3)
