"""An E1.31 receiver that drives lights: decodes datagrams by its own hand [ANSI-E131-2018]."""

from __future__ import annotations

import dataclasses
import struct
import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from sim.devices.faults import FaultLog, Story
from sim.devices.led_device import EndDevice
from sim.devices.led_ends import UdpEnd
from sim.devices.led_faults import Step
from sim.devices.led_unanswered import UnansweredLeds

SOURCE_LOSS_S = 2.5
"""A source that is silent for so long is lost."""
ACN = b"ASC-E1.17\x00\x00\x00"


@dataclasses.dataclass(frozen=True)
class DataPacket:
    """The content of an E1.31 data packet; slots without the start code."""

    cid: bytes
    name: str
    priority: int
    sequence: int
    terminated: bool
    universe: int
    slots: bytes


def read_packet(data: bytes) -> DataPacket | None:
    """A datagram's content; None where it is no data packet of dimmer levels.

    Lengths are counted from the layers' own first bytes: the root's at 16, the frame's at 38, the
    property layer's at 115.
    """
    if len(data) < 126 or data[:4] != b"\x00\x10\x00\x00" or data[4:16] != ACN:
        return None
    for start in (16, 38, 115):
        (flags_and_length,) = struct.unpack_from("!H", data, start)
        if flags_and_length >> 12 != 7 or (flags_and_length & 0xFFF) != len(data) - start:
            return None
    if data[18:22] != b"\0\0\0\4" or data[40:44] != b"\0\0\0\2":
        return None
    if data[117:119] != b"\x02\xa1" or data[119:123] != b"\0\0\0\1":
        return None
    (count,) = struct.unpack_from("!H", data, 123)
    if count != len(data) - 125 or count > 513 or data[125] != 0:
        return None
    (universe,) = struct.unpack_from("!H", data, 113)
    return DataPacket(
        cid=data[22:38],
        name=data[44:108].split(b"\0")[0].decode(errors="replace"),
        priority=data[108],
        sequence=data[111],
        terminated=bool(data[112] & 0x40),
        universe=universe,
        slots=data[126:],
    )


@dataclasses.dataclass
class Source:
    """Who drives a universe at the moment."""

    cid: bytes
    priority: int
    sequence: int
    heard_s: float


class SacnDevice(EndDevice):
    """Lights on universes, from one source at a time.

    A universe whose source ends or is lost goes dark. Of two sources the one of higher priority
    counts, of equal ones the first.

    Args:
        light_count: lights, whole ones universe after universe.
        show: called with (n,) levels in 0..1 whenever what shines changes.
        universe: of the first light.
        channels: slots of a light, or pairs of them.
        bits: 8, or 16: a coarse slot before a fine one.
        story: what goes wrong; nothing by default.
        log: where that is noted.
        banks: polarisation bank of each light, for a story that swaps them.

    Attributes:
        packets: data packets that were understood, of any source.
        lost: numbers that were left out in the sequences.
        dropped: packets that came too late, by their number.
        strangers: packets of sources that did not count.
        malformed: datagrams that were none.
        terminated: universes whose source announced its end.
        source_losses: universes whose source fell silent.
    """

    def __init__(
        self,
        light_count: int,
        show: Callable[[np.ndarray], None],
        universe: int = 1,
        channels: int = 1,
        bits: int = 8,
        story: Story | None = None,
        log: FaultLog | None = None,
        banks: Sequence[str] = (),
    ) -> None:
        super().__init__(light_count, UdpEnd(), show, log)
        self._leds = UnansweredLeds(
            light_count, self._decode, self._settle, story or Story(), self.log, banks
        )
        self._first = universe
        self._channels, self._bytes = channels, bits // 8
        self._per_universe = 512 // (channels * self._bytes)
        self._universes = -(-light_count // self._per_universe)
        self._sources: dict[int, Source] = {}
        self.packets = self.lost = self.dropped = self.strangers = self.malformed = 0
        self.terminated: list[int] = []
        self.source_losses: list[int] = []
        self.connected.set()

    def url(self, options: str = "") -> str:
        """The device's address for `lightstage capture --leds`; options as ``name=value&..``."""
        own = f"universe={self._first}&channels={self._channels}&bits={8 * self._bytes}"
        return f"sacn://{self.path}?{own}&{options}".rstrip("&")

    def _opened(self) -> Iterable[Step]:
        return []

    def _feed(self, data: bytes) -> Iterator[Step]:
        yield from self._leds.feed(data)

    def _decode(self, data: bytes) -> np.ndarray | None:
        packet = read_packet(data)
        if packet is None or not 0 <= packet.universe - self._first < self._universes:
            self.malformed += 1
            return None
        self.packets += 1
        if not self._accept(packet):
            return None
        if packet.terminated:
            self.terminated.append(packet.universe)
            del self._sources[packet.universe]
            return self._with(packet.universe, b"")
        return self._with(packet.universe, packet.slots)

    def _accept(self, packet: DataPacket) -> bool:
        """Whether a packet counts; its source is remembered."""
        source = self._sources.get(packet.universe)
        if source is None and packet.terminated:
            return False  # one that has ended announces it more than once
        if source is not None and source.cid != packet.cid and packet.priority <= source.priority:
            self.strangers += 1
            return False
        if source is not None and source.cid == packet.cid:
            ahead = (packet.sequence - source.sequence + 128) % 256 - 128
            if -20 < ahead <= 0:
                self.dropped += 1
                return False
            self.lost += max(0, ahead - 1)
        self.heard_s = time.monotonic()
        self._sources[packet.universe] = Source(
            packet.cid, packet.priority, packet.sequence, self.heard_s
        )
        return True

    def _with(self, universe: int, slots: bytes) -> np.ndarray:
        """(n,) counts with one universe's lights as in these slots."""
        size = self._channels * self._bytes
        counts = self._leds.counts.copy()
        start = (universe - self._first) * self._per_universe
        for light in range(start, min(start + self._per_universe, len(counts))):
            own = slots[(light - start) * size :][: self._bytes].ljust(self._bytes, b"\0")
            value = int.from_bytes(own, "big")
            counts[light] = value * 257 if self._bytes == 1 else value
        return counts

    def _deadline_s(self) -> float | None:
        heard = [source.heard_s for source in self._sources.values()]
        return min(heard) + SOURCE_LOSS_S if heard else None

    def _expire(self) -> None:
        now_s = time.monotonic()
        for universe, source in list(self._sources.items()):
            if now_s - source.heard_s >= SOURCE_LOSS_S:
                del self._sources[universe]
                if not self._leds.dead:
                    self._leds.light(self._with(universe, b""))
                # Last: who sees that a source is lost sees its lights dark too.
                self.silences += 1
                self.source_losses.append(universe)
