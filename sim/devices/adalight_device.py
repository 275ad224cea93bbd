"""An Adalight board on a pseudo-terminal: decodes frames by itself, answers nothing [Burgess2011].

Its strip is white: an LED shines as bright as its strongest primary.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from sim.devices.faults import FaultLog, Story
from sim.devices.led_device import EndDevice
from sim.devices.led_ends import PtyEnd
from sim.devices.led_faults import Step
from sim.devices.led_unanswered import UnansweredLeds

BOOT_WORD = b"Ada\n"
HEADER_BYTES = 6
SERIAL_TIMEOUT_S = 15.0
"""After so long without a byte the usual sketch turns all LEDs off [Burgess2011]."""


def cut_frames(stream: bytes) -> tuple[list[bytes], bytes]:
    """Whole frames (header and pixels) of a byte stream, and what is left for later.

    A header counts when its checksum is right; bytes before one are skipped, as the sketch does.
    """
    frames: list[bytes] = []
    while (start := stream.find(b"Ada")) >= 0:
        stream = stream[start:]
        if len(stream) < HEADER_BYTES:
            return frames, stream
        high, low, check = stream[3:6]
        if check != high ^ low ^ 0x55:
            stream = stream[1:]
            continue
        size = HEADER_BYTES + 3 * (high * 256 + low + 1)
        if len(stream) < size:
            return frames, stream
        frames.append(stream[:size])
        stream = stream[size:]
    return frames, stream[-2:]  # the beginning of a magic word, perhaps


class AdalightDevice(EndDevice):
    """The board and its strip.

    Args:
        light_count: LEDs of the strip; a longer frame's others go nowhere, a shorter one leaves
            the rest as they are.
        show: called with (n,) levels in 0..1 whenever what shines changes.
        story: what goes wrong; nothing by default.
        log: where that is noted.
        banks: polarisation bank of each light, for a story that swaps them.
        greets: whether it sends its word when its port is opened.
        timeout_s: after so long without a byte its LEDs go off.

    Attributes:
        pixels: (n, 3) bytes of the last frame.
        frames: how many came whole.
    """

    def __init__(
        self,
        light_count: int,
        show: Callable[[np.ndarray], None],
        story: Story | None = None,
        log: FaultLog | None = None,
        banks: Sequence[str] = (),
        greets: bool = True,
        timeout_s: float = SERIAL_TIMEOUT_S,
    ) -> None:
        super().__init__(light_count, PtyEnd(), show, log)
        self._leds = UnansweredLeds(
            light_count, self._decode, self._settle, story or Story(), self.log, banks
        )
        self._pending = b""
        self._greets = greets
        self._timeout_s = timeout_s
        self.pixels = np.zeros((light_count, 3), np.uint8)
        self.frames = 0

    def url(self, options: str = "") -> str:
        """The device's address for `lightstage capture --leds`; options as ``name=value&..``."""
        return f"adalight://{self.path}?{options}"

    def _opened(self) -> Iterable[Step]:
        self._pending = b""
        return [BOOT_WORD] if self._greets else []

    def _feed(self, data: bytes) -> Iterator[Step]:
        self.heard_s = time.monotonic()
        frames, self._pending = cut_frames(self._pending + data)
        for frame in frames:
            yield from self._leds.feed(frame)

    def _decode(self, frame: bytes) -> np.ndarray | None:
        whole, _ = cut_frames(frame)
        if not whole:
            return None  # the line has damaged its header
        self.frames += 1
        sent = np.frombuffer(whole[0][HEADER_BYTES:], np.uint8).reshape(-1, 3)[: len(self.pixels)]
        self.pixels = np.concatenate([sent, self.pixels[len(sent) :]])
        return self.pixels.max(axis=1).astype("<u2") * 257

    def _deadline_s(self) -> float | None:
        if self._leds.dead or not self._leds.counts.any():
            return None
        return self.heard_s + self._timeout_s

    def _expire(self) -> None:
        due_s = self._deadline_s()
        if due_s is not None and time.monotonic() >= due_s:
            self.silences += 1
            self.pixels = np.zeros_like(self.pixels)
            self._leds.light(np.zeros_like(self._leds.counts))
