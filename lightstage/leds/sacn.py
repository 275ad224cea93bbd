"""Lights on E1.31 (sACN) universes: UDP, not acknowledged [ANSI-E131-2018]."""

from __future__ import annotations

import socket
import uuid

import numpy as np

from lightstage.counting import counted
from lightstage.errors import ConfigError, DeviceError
from lightstage.leds import e131
from lightstage.leds.address import MULTICAST, SacnOptions
from lightstage.leds.connection import lock_address
from lightstage.leds.controller import Hello, LightLostError, level_steps, require_levels
from lightstage.leds.guard import LastWill
from lightstage.leds.unanswered import UnansweredLeds

NAME = "lightstage"
END_PACKETS = 3
"""A source that ends announces it three times."""
SPREAD = (0, 64, 128, 192)
"""A receiver drops a packet whose number is up to 19 behind the last: of these it drops one."""


class SacnLeds(UnansweredLeds):
    """Lights behind E1.31 receivers (LedController): not acknowledged.

    Args:
        host: of the receiver, or `multicast`.
        port: UDP port of the receiver.
        light_count: lights of the rig; they fill universe after universe in order, whole lights.
        options: universe, channels, bits, priority.

    Raises:
        ConfigError: more lights than there are universes.
        DeviceError: no such host, or in use by another program of this machine.
    """

    def __init__(self, host: str, port: int, light_count: int, options: SacnOptions) -> None:
        where = f"E1.31 to {host}:{port}"
        firmware = f"{where} (does not answer)"
        super().__init__(where, light_count, firmware, options, e131.KEEP_ALIVE_S)
        self._options = options
        self._full = 255 if options.bits == 8 else 65535
        per_universe = e131.SLOTS // (options.channels * options.bits // 8)
        self._starts = range(0, light_count, per_universe)
        self._universes = [options.universe + index for index in range(len(self._starts))]
        self._per_universe = per_universe
        if self._universes[-1] > e131.MAX_UNIVERSE:
            raise ConfigError(
                "--leds",
                field="universe",
                found=f"{counted(light_count, 'lamp')} up to universe {self._universes[-1]}",
                expected=f"at most {e131.MAX_UNIVERSE}",
            )
        # The same machine and the same address make the same sender.
        self._cid = uuid.uuid5(uuid.NAMESPACE_URL, f"sacn://{uuid.getnode():x}/{host}:{port}").bytes
        self._sequences = [0] * len(self._universes)
        self._lock = lock_address(f"udp {host}:{port}")
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.settimeout(options.timeout_s)
            if options.interface:
                card = socket.inet_aton(options.interface)
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, card)
            found = None if host == MULTICAST else socket.gethostbyname(host)
        except OSError as error:
            self.close()
            raise DeviceError(
                self._where, found=str(error), expected="a host and a network that are there"
            ) from None
        self._places = [(found or e131.multicast_host(u), port) for u in self._universes]

    def _to_steps(self, levels: np.ndarray) -> np.ndarray:
        # Checked before the root, which could bring a level out of range back into it.
        return level_steps(require_levels(levels) ** (1 / self._options.gamma), self._full)

    def _to_levels(self, steps: np.ndarray) -> np.ndarray:
        return np.asarray((steps / self._full) ** self._options.gamma)

    def recover(self) -> Hello:
        """Nothing to greet: zeros."""
        self.dark()
        return self._hello

    def last_will(self) -> LastWill:
        """Zeros, then the end of the stream, under numbers of which no receiver drops them all."""
        messages = [
            (self._packet(index, number, b"", options), place)
            for options in (0, e131.TERMINATED)
            for number in SPREAD
            for index, place in enumerate(self._places)
        ]
        handles = (self._socket.fileno(), self._lock.fileno())
        return LastWill(handles, tuple(messages), rounds=1)

    def close(self) -> None:
        """End the stream: receivers do then what they do without a source."""
        try:
            if hasattr(self, "_places"):
                with self._turn:
                    self._send(END_PACKETS, e131.TERMINATED)
        except LightLostError:
            pass  # nobody hears that it ends: its receivers find out by themselves
        finally:
            if hasattr(self, "_socket"):
                self._socket.close()
            self._lock.close()

    def _send(self, times: int, options: int = 0) -> None:
        try:
            for _ in range(times):
                for index, place in enumerate(self._places):
                    self._sequences[index] += 1
                    slots = self._slots(index)
                    packet = self._packet(index, self._sequences[index], slots, options)
                    self._socket.sendto(packet, place)
        except OSError as error:
            raise LightLostError(
                self._where,
                found=str(error),
                expected="a network that takes the packets",
                hint="The lights may be as they were last set.",
            ) from None

    def _slots(self, index: int) -> bytes:
        start = self._starts[index]
        steps = self._steps[start : start + self._per_universe]
        each = np.repeat(steps, self._options.channels)
        return each.astype("u1" if self._options.bits == 8 else ">u2").tobytes()

    def _packet(self, index: int, number: int, slots: bytes, options: int) -> bytes:
        universe = self._universes[index]
        return e131.data_packet(
            self._cid, NAME, universe, number, slots, self._options.priority, options
        )
