"""The firmware on its bench (firmware/host/bench.c), from Python; also in a simulated device."""

from __future__ import annotations

import dataclasses
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Self

import numpy as np

from sim.devices.led_protocol import LedProtocol

BOOT = 0xA1B2C3D4
PATIENCE_S = 60.0


@dataclasses.dataclass(frozen=True)
class Heard:
    """What the firmware did with one record.

    Attributes:
        replies: bytes that it sent.
        lamps: (n,) u16 levels, for each time that it wrote them.
    """

    replies: bytes
    lamps: list[np.ndarray]


class Bench:
    """The firmware as a process. Use as a context manager; it is not reset at the beginning.

    Args:
        program: firmware/host/bench, compiled.
        lamps_say: gives (n,) u16 levels at which the lamps shine; without it the firmware cannot
            know, and tells what it wrote.
        written: called with (n,) u16 levels as soon as the lamps are written.
    """

    def __init__(
        self,
        program: Path,
        lamps_say: Callable[[], np.ndarray] | None = None,
        written: Callable[[np.ndarray], None] = lambda _: None,
    ) -> None:
        command = [str(program)] + (["--ask"] if lamps_say else [])
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._lamps_say, self._written = lamps_say, written

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        # A sanitizer that found something says so on stderr and ends it otherwise.
        assert self._process.wait(PATIENCE_S) == 0
        self._process.stdout.close()

    def reset(self, boot_id: int = BOOT) -> Heard:
        """Switch it off and on."""
        return self._told("z", boot_id)

    def line(self, data: bytes) -> Heard:
        """These bytes come on the line."""
        return self._told("b", len(data), data)

    def clock(self, ms: int) -> Heard:
        """The clock shows this, and the main loop looks at it."""
        return self._told("c", ms % 2**32)

    def settling(self, ms: int) -> Heard:
        """From now on the lamps take so long."""
        return self._told("s", ms)

    def _told(self, letter: str, number: int, data: bytes = b"") -> Heard:
        self._write(struct.pack("<cI", letter.encode(), number) + data)
        replies, lamps = b"", []
        while True:
            kind, size = struct.unpack("<cI", self._read(5))
            if kind == b"d":
                return Heard(replies, lamps)
            if kind == b"q":
                assert self._lamps_say is not None
                self._write(self._lamps_say().astype("<u2").tobytes())
                continue
            found = self._read(size)
            if kind == b"r":
                replies += found
            else:
                lamps.append(np.frombuffer(found, "<u2"))
                self._written(lamps[-1])

    def _write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(data)
        self._process.stdin.flush()

    def _read(self, size: int) -> bytes:
        assert self._process.stdout is not None
        data = self._process.stdout.read(size)
        assert len(data) == size, f"the firmware ended with {self._process.wait(PATIENCE_S)}"
        return data


def states(lamps: list[np.ndarray]) -> list[list[int]]:
    """What the lamps showed one after the other, repetitions left out."""
    found: list[list[int]] = []
    for levels in lamps:
        if not found or found[-1] != levels.tolist():
            found.append(levels.tolist())
    return found


class FirmwareProtocol(LedProtocol):
    """The firmware in the place of the simulated device's own protocol.

    The simulated device still plays the line and the lamps, with their faults: what the firmware
    writes goes to those lamps, and what they tell of themselves is what it acknowledges.
    """

    def __init__(self, program: Path, clock: Callable[[], float], *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self._clock = clock
        self._bench = Bench(program, self._told, self._light)
        self._hello = self._bench.reset(self.boot_id).replies

    def close(self) -> None:
        """End the process."""
        self._bench.__exit__()

    def hello(self, sequence: int = 0) -> bytes:
        """The HELLO with which the firmware came up."""
        assert sequence == 0
        return self._hello

    def reset(self, boot_id: int) -> None:
        super().reset(boot_id)
        self._hello = self._bench.reset(boot_id).replies

    def put_out(self) -> None:
        """Time has passed: it is the firmware that must know what to do."""
        self._pass_time()

    def answer(self, frame: bytes) -> bytes:
        self._pass_time()
        replies = self._bench.line(frame + b"\0").replies
        self.heard += bool(replies)
        return replies

    def _pass_time(self) -> None:
        self._bench.clock(int(1e3 * self._clock()))

    def _told(self) -> np.ndarray:
        stated = self._shining.reported
        if self.lies > 0:
            self.lies -= 1
            stated = np.bitwise_xor(stated, 1)
        return stated
