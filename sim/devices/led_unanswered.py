"""Lamps behind a wire that never answers, to which a story happens. No port, no clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sim.devices.fault_names import LEDS
from sim.devices.faults import FaultLog, Story
from sim.devices.led_faults import FaultyLamps, Line, Step, Wait, require_lights
from sim.devices.led_protocol import FULL_COUNT


class UnansweredLeds:
    """Takes whole packets, lights lamps, answers nothing.

    Of the LED faults those of the line (toward the device), of the lamps, `die` and `reset` happen
    here; there is no answer that could be wrong or lost.

    Args:
        light_count: lights that it drives.
        decode: from one packet's bytes to (n,) uint16 counts; None where it changes nothing.
        show: called with (n,) levels in 0..1 whenever what shines changes.
        story: what goes wrong.
        log: where that is noted.
        banks: polarisation bank of each light, for a story that swaps them.

    Attributes:
        counts: (n,) uint16 that were commanded.
        dead: whether it died, with its lights as they were.

    Raises:
        SimError: a light that is not there, or banks that cannot be swapped.
    """

    def __init__(
        self,
        light_count: int,
        decode: Callable[[bytes], np.ndarray | None],
        show: Callable[[np.ndarray], None],
        story: Story,
        log: FaultLog,
        banks: Sequence[str] = (),
    ) -> None:
        self._lamps = FaultyLamps(banks)
        require_lights(story, light_count, self._lamps)
        self._decode = decode
        self._show = show
        self._story = story
        self._log = log
        self._line = Line("request", log)
        self._packets = 0
        self.dead = False
        self.counts = np.zeros(light_count, "<u2")
        self._shining = self.counts

    def feed(self, packet: bytes) -> Iterator[Step]:
        """Take one packet; the steps must be taken one by one, in order."""
        self._packets += 1
        due = self._story.due(LEDS, "packet", self._packets)
        for each in due:
            if each.name in ("die", "reset"):
                self._log.write(LEDS, each, self._packets)
            if each.name == "die":
                self.dead = True
            elif each.name == "reset":
                self.light(np.zeros_like(self.counts))
                yield Wait(each.fault["seconds"], deaf=True)
                return
            elif each.fault.kind.lasts and each.fault not in self._lamps.broken:
                self._log.write(LEDS, each, self._packets)
        broken = [each.fault for each in due if each.fault.kind.lasts]
        if broken != self._lamps.broken:
            self._lamps.broken = broken
            self.light(self.counts)
        wait_s, arrived = self._line.carry(packet, due, self._packets)
        if wait_s > 0:
            yield Wait(wait_s)
        for each_packet in arrived:
            counts = None if self.dead else self._decode(each_packet)
            if counts is not None:
                self.light(counts)

    def light(self, counts: np.ndarray) -> None:
        """Command (n,) counts; lamps are shown when that changes what shines."""
        self.counts = counts
        shining = self._lamps(counts).counts
        if not np.array_equal(shining, self._shining):
            self._show(shining.astype(float) / FULL_COUNT)
        self._shining = shining
