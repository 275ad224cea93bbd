"""A capture's journal as lines: nine cameras, seven patterns, things that go wrong."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.lightstage.operator.emulator import Emulator

PATTERNS = ["full", "x+", "x-", "y+", "y-", "z+", "z-"]
Line = dict[str, Any]


class Story:
    """Writes lines as a capture does; times are invented, and steady.

    Attributes:
        lines: all of them.
        s: seconds since the beginning.
    """

    def __init__(self, cameras: int = 9, patterns: list[str] | None = None) -> None:
        self.cameras = [f"cam{i}" for i in range(cameras)]
        self.patterns = PATTERNS if patterns is None else patterns
        self.lines: list[Line] = []
        self.s = 0.0

    def add(self, event: str, after_s: float = 0.1, **facts: Any) -> Line:
        """One line, some time after the one before it."""
        self.s = round(self.s + after_s, 3)
        seconds = 37200 + int(self.s)
        clock = f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}"
        line = {
            "id": len(self.lines) + 1,
            "time_utc": f"2031-05-06T{clock}.000+00:00",
            "elapsed_s": self.s,
            "event": event,
            **facts,
        }
        self.lines.append(line)
        return line

    def begin(self) -> None:
        values = {
            name: {
                "serial": f"60123{i}5",
                "model": "Nikon DSC D750",
                "battery_percent": 90.0 - 9 * i,
                "card_free_bytes": 61_000_000_000 - i * 7_000_000_000,
            }
            for i, name in enumerate(self.cameras)
        }
        self.add(
            "begin",
            schema="lightstage.journal/2",
            subject="P1",
            expression="neutral",
            sequence=self.patterns,
            cameras=self.cameras,
        )
        leds = {
            "boot_id": 4711,
            "light_count": 168,
            "firmware": "stage 1.4",
            "acknowledged": True,
        }
        self.add("devices", led_device=leds, told=values)

    def light(self, pattern: str, take: int = 1, cameras: list[str] | None = None) -> None:
        """Up to the trigger."""
        self.add("lit", 0.4, pattern=pattern, acknowledged=True, levels=[1.0] * 168)
        takes = dict.fromkeys(self.cameras if cameras is None else cameras, take)
        self.add("trigger", pattern=pattern, takes=takes)

    def expose(self, pattern: str, camera: str, take: int = 1) -> None:
        file = {"name": f"/store/DSC_{len(self.lines):04}.NEF", "size": 24_300_000}
        self.add("exposed", 0.05, pattern=pattern, camera=camera, take=take, file=file)

    def keep(self, pattern: str, camera: str, take: int = 1) -> None:
        self.expose(pattern, camera, take)
        path = f"frames/{pattern}/{camera}{'' if take == 1 else f'.take{take}'}.nef"
        self.add(
            "frame", 0.2, pattern=pattern, camera=camera, take=take, path=path, size=24_300_000
        )

    def shoot(self, pattern: str) -> None:
        """A whole pattern without any trouble."""
        self.light(pattern)
        for camera in self.cameras:
            self.keep(pattern, camera)
        self.add("shot", pattern=pattern)

    def not_taken(self, pattern: str, camera: str, why: str) -> Line:
        return self.add(
            "finding",
            severity="retake",
            code="not-taken",
            where=f"{pattern} by {camera}",
            found=why,
            expected="a photograph",
            hint="Look at its cable and battery, switch it off and on, then press r.",
            pattern=pattern,
            camera=camera,
        )


@pytest.fixture
def story() -> Callable[..., Story]:
    return Story


@pytest.fixture
def replay() -> list[Line]:
    """A whole capture with a failed camera, a retake, a pause, and an end."""
    stated = Story()
    stated.begin()
    for pattern in PATTERNS[:3]:
        stated.shoot(pattern)
    stated.light("y+")
    for camera in stated.cameras:
        if camera != "cam4":
            stated.keep("y+", camera)
    stated.add("failed", 9.0, pattern="y+", camera="cam4", take=1, said="no answer for 30 s")
    stated.add("note", camera="cam4", said="started again")
    stated.not_taken("y+", "cam4", "no answer for 30 s")
    stated.light("y+", 2, ["cam4"])
    stated.keep("y+", "cam4", 2)
    stated.add("shot", pattern="y+")
    stated.add("note", said="paused, the lights are dark")
    for pattern in PATTERNS[4:]:
        stated.shoot(pattern)
    stated.add("end", frames=63)
    return stated.lines


def write_lines(path: Path, lines: list[Line]) -> Path:
    """A journal file of these lines."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


@pytest.fixture
def written() -> Callable[[Path, list[Line]], Path]:
    return write_lines


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch, tmp_path_factory) -> Iterator[Path]:
    """A runtime folder of its own."""
    folder = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    return folder / "lightstage"


class Terminal:
    """A process with a terminal of its own, as an operator has it.

    Attributes:
        process: the child; the terminal is its controlling one.
        emulator: what its screen shows.
    """

    def __init__(self, arguments: list[str], columns: int = 100, rows: int = 30) -> None:
        self._ours, self._theirs = pty.openpty()
        termios.tcsetwinsize(self._theirs, (rows, columns))
        self.before = self.mode()
        self._said = bytearray()
        self.emulator = Emulator(columns, rows)
        self._lock = threading.Lock()
        environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
        self.process = subprocess.Popen(
            [sys.executable, "-c", BECOME, *arguments],
            stdin=self._theirs,
            stdout=self._theirs,
            stderr=self._theirs,
            start_new_session=True,
            env={**environment, "TERM": "xterm-256color", "PYTHONIOENCODING": "utf-8"},
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        """All that was shown so far, without control codes."""
        text = bytes(self._said).decode(errors="replace")
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)

    def mode(self) -> list[Any]:
        """How the terminal is set."""
        return termios.tcgetattr(self._theirs)

    def resize(self, columns: int, rows: int) -> None:
        """Another size of the window; the process gets its signal, SIGWINCH."""
        with self._lock:
            self.emulator.resize(columns, rows)
            termios.tcsetwinsize(self._theirs, (rows, columns))

    def press(self, keys: str) -> None:
        os.write(self._ours, keys.encode())

    def wait_for(self, text: str, since: int = 0) -> int:
        """Wait until something is shown; returns how much was shown by then."""
        return self.wait_until(lambda: text in self.output[since:], f"{text!r} was not shown")

    def wait_until(self, done: Callable[[], bool], failure: str | Callable[[], str]) -> int:
        until_s = time.monotonic() + 60
        while not done():
            if time.monotonic() >= until_s:
                said = failure() if callable(failure) else f"{failure}: {self.output[-3000:]}"
                pytest.fail(said)
            time.sleep(0.01)
        return len(self.output)

    def end(self) -> int:
        """Wait for the process; returns its code."""
        return self.process.wait(60)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._theirs)
        self._reader.join(10)
        os.close(self._ours)

    def _read(self) -> None:
        while True:
            try:
                piece = os.read(self._ours, 65536)
            except OSError:
                return
            with self._lock:
                self._said += piece
                self.emulator.feed(piece)


BECOME = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""


@pytest.fixture
def terminals() -> Iterator[Callable[..., Terminal]]:
    """Makes terminals, and closes them."""
    opened: list[Terminal] = []

    def make(*arguments: str, **size: int) -> Terminal:
        opened.append(Terminal(list(arguments), **size))
        return opened[-1]

    yield make
    for terminal in opened:
        terminal.close()
