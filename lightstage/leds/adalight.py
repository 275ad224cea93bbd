"""Adalight on a serial line: three bytes an LED, no answer [Burgess2011]."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from lightstage.leds.address import AdalightOptions
from lightstage.leds.connection import Line, opened
from lightstage.leds.controller import Hello, LightLostError, level_steps, require_levels
from lightstage.leds.guard import LastWill
from lightstage.leds.unanswered import UnansweredLeds

BOOT_WORD = b"Ada\n"
"""What a board sends when it has come up (and now and then while it receives nothing)."""


class SerialLine(Line, Protocol):
    """A line that knows when its last byte is out."""

    def drain(self) -> None:
        """Wait for that."""


def header(light_count: int) -> bytes:
    """``Ada``, the count less one (big endian), and both its bytes XOR 0x55 [Burgess2011]."""
    high, low = divmod(light_count - 1, 256)
    return b"Ada" + bytes([high, low, high ^ low ^ 0x55])


class Tint:
    """From levels to the bytes of LEDs of three primaries.

    Args:
        colour: RRGGBB of full level.
        order: in which an LED takes them.
        gamma: light goes with (byte / full byte) ** gamma.
    """

    def __init__(self, colour: str, order: str, gamma: float) -> None:
        rgb = dict(zip("rgb", bytes.fromhex(colour), strict=True))
        self._primaries = np.array([rgb[name] for name in order], float)
        self._full = int(self._primaries.max())
        self._gamma = gamma

    def steps(self, levels: np.ndarray) -> np.ndarray:
        """(n,) step of the strongest primary, for (n,) levels in 0..1; DeviceError for others."""
        # Checked before the root, which could bring a level out of range back into it.
        return level_steps(require_levels(levels) ** (1 / self._gamma), self._full)

    def driven(self, steps: np.ndarray) -> np.ndarray:
        """(n,) levels in 0..1 that (n,) steps make."""
        return np.asarray((steps / self._full) ** self._gamma)

    def pixels(self, steps: np.ndarray) -> bytes:
        """Three bytes an LED, of (n,) steps."""
        values = np.round(steps[:, None] * (self._primaries / self._full))
        return values.astype(np.uint8).tobytes()


class AdalightLeds(UnansweredLeds):
    """LEDs behind an Adalight board (LedController): not acknowledged.

    Args:
        where: its name in messages.
        connect: opens the line; called again by `recover`.
        light_count: lights of the rig, in the strip's order.
        options: colour, gamma, repetitions.

    Raises:
        DeviceError: the line cannot be opened, or takes no bytes.
    """

    def __init__(
        self,
        where: str,
        connect: Callable[[], SerialLine],
        light_count: int,
        options: AdalightOptions,
    ) -> None:
        super().__init__(where, light_count, "Adalight (does not answer)", options)
        self._connect = connect
        self._timeout_s = options.timeout_s
        self._tint = Tint(options.colour, options.order, options.gamma)
        self._cut = self._broken = False
        self._line = self._open()

    def _to_steps(self, levels: np.ndarray) -> np.ndarray:
        return self._tint.steps(levels)

    def _to_levels(self, steps: np.ndarray) -> np.ndarray:
        return self._tint.driven(steps)

    def recover(self) -> Hello:
        """Open the port again if it broke, black."""
        with self._turn:
            if self._broken:
                self._line.close()
                self._line = self._open()
                self._broken = self._cut = False
            self.dark()
            return self._hello

    def last_will(self) -> LastWill:
        """Zeros to end a frame that was half sent, then black."""
        count = self._hello.light_count
        black = header(count) + bytes(3 * count)
        return LastWill(self._line.handles, ((bytes(3 * count) + black + black, None),))

    def close(self) -> None:
        """Close the port; lights stay as they are."""
        self._line.close()

    def _open(self) -> SerialLine:
        """Open the line and give a board that starts then the time to report it."""
        line = opened(self._connect, self._where)
        try:
            heard = b""
            until = time.monotonic() + self._timeout_s
            while BOOT_WORD not in heard and (left_s := until - time.monotonic()) > 0:
                heard += line.read(left_s)
        except OSError as error:
            line.close()
            raise self._lost(error) from None
        return line

    def _send(self, times: int) -> None:
        frame = header(len(self._steps)) + self._tint.pixels(self._steps)
        # What an interrupt left half sent is ended by zeros, which light nothing.
        before = bytes(3 * len(self._steps)) if self._cut else b""
        self._cut = True
        try:
            self._line.write(before + times * frame)
            self._line.drain()
        except OSError as error:
            self._broken = True
            raise self._lost(error) from None
        self._cut = False

    def _lost(self, error: OSError) -> LightLostError:
        return LightLostError(
            self._where,
            found=str(error),
            expected="a line that takes the bytes",
            hint="Was the cable pulled? The lights may be as they were last set.",
        )
