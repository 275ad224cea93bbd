"""How an LED device misbehaves: its line, its lamps, its restarts. No port, no clock.

What it does comes as steps: bytes to send, and waits for whoever holds the clock.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sim.devices.fault_names import LEDS, OF_ICL
from sim.devices.faults import Due, Fault, FaultLog, Story
from sim.devices.led_protocol import FULL_COUNT, LedProtocol, Shining
from sim.errors import SimError


@dataclasses.dataclass(frozen=True)
class Wait:
    """A step of waiting.

    Attributes:
        seconds: how long.
        deaf: what comes meanwhile is lost: the device restarts.
    """

    seconds: float
    deaf: bool = False


Step = bytes | Wait


class FaultyLamps:
    """From what was commanded to what shines and what is reported of it.

    Args:
        banks: polarisation bank of each light, in the rig's order.
    """

    def __init__(self, banks: Sequence[str]) -> None:
        names = sorted(set(banks))
        members = [np.flatnonzero(np.array(banks) == name) for name in names]
        self.swapped = np.arange(len(banks))
        if len(members) == 2 and len(members[0]) == len(members[1]):
            self.swapped[members[0]], self.swapped[members[1]] = members[1], members[0]
        self.broken: list[Fault] = []

    def __call__(self, commanded: np.ndarray) -> Shining:
        """What (n,) commanded counts become, the faults in order."""
        counts, reported = commanded.copy(), commanded.copy()
        for fault in self.broken:
            if fault.name == "swapped-bank":
                counts = counts[self.swapped]
                continue
            lights = np.array(fault["lights"])
            level = FULL_COUNT if fault.name.startswith("stuck-on") else 0
            counts[lights] = level
            if not fault.name.endswith("-hidden"):
                reported[lights] = level
        return Shining(counts, reported)


class Line:
    """One direction of the line.

    Args:
        way: ``request`` or ``answer``.
        log: where it is noted what happened.
    """

    def __init__(self, way: str, log: FaultLog) -> None:
        self._way = way
        self._log = log
        self._held: list[bytes] = []

    def carry(self, frame: bytes, due: Sequence[Due], count: int) -> tuple[float, list[bytes]]:
        """What arrives of one frame (bytes without a zero), and after how many seconds.

        Args:
            frame: that enters the line.
            due: what happens to this packet.
            count: which packet it is.
        """
        arrived, behind = [frame], self._held
        self._held, wait_s = [], 0.0
        for fault in due:
            if fault.fault.kind.fields.get("way") is None or fault.fault["way"] != self._way:
                continue
            self._log.write(LEDS, fault, count, self._way)
            if fault.name == "drop":
                arrived = []
            elif fault.name == "corrupt":
                arrived = [_flipped(each, fault) for each in arrived]
            elif fault.name == "delay":
                wait_s += float(fault.fault["seconds"])
            elif fault.name == "duplicate":
                arrived = 2 * arrived
            elif fault.name == "reorder":
                self._held, arrived = self._held + arrived, []
        return wait_s, arrived + behind


class FaultyLeds:
    """An LED device to which a story happens.

    Args:
        light_count: lights that it drives.
        boot_id: its first; each restart adds one.
        show: called with (n,) levels in 0..1 whenever what shines changes.
        story: what goes wrong.
        log: where that is noted.
        banks: polarisation bank of each light; needed by a story with ``swapped-bank``.
        watchdog_s: what its HELLO has of it; whoever holds the clock keeps it.

    Raises:
        SimError: a light that is not there, or banks that cannot be swapped.
    """

    def __init__(
        self,
        light_count: int,
        boot_id: int,
        show: Callable[[np.ndarray], None],
        story: Story,
        log: FaultLog,
        banks: Sequence[str] = (),
        watchdog_s: float | None = None,
    ) -> None:
        self._lamps = FaultyLamps(banks)
        require_lights(story, light_count, self._lamps)
        self.protocol = LedProtocol(light_count, boot_id, show, self._lamps, watchdog_s)
        self._story = story
        self._log = log
        self._packets = self._opens = 0
        self._dead = False
        self._request, self._answer = Line("request", log), Line("answer", log)

    @property
    def dead(self) -> bool:
        """Whether it died, with its lights as they were."""
        return self._dead

    def opened(self) -> Iterator[Step]:
        """The host has opened the port."""
        self._opens += 1
        due = self._story.due(LEDS, "open", self._opens)
        for each in due:
            self._log.write(LEDS, each, self._opens)
        if due or self._dead:
            yield from self._restart(max([float(each.fault["seconds"]) for each in due] or [0.0]))

    def feed(self, data: bytes) -> Iterator[Step]:
        """Take bytes from the host; the steps must be taken one by one, in order."""
        for frame in self.protocol.frames(data):
            self._packets += 1
            due = self._story.due(LEDS, "packet", self._packets)
            self._break_lamps(due)
            for each in due:
                if each.name == "die" and not self._dead:
                    self._log.write(LEDS, each, self._packets)
                    self._dead = True
                elif each.name == "wrong-acknowledgement":
                    self._log.write(LEDS, each, self._packets)
                    self.protocol.lies = 1
                elif each.name == "reset":
                    self._log.write(LEDS, each, self._packets)
                    yield from self._restart(each.fault["seconds"])
                    return
            wait_s, arrived = self._request.carry(frame, due, self._packets)
            if wait_s > 0:
                yield Wait(wait_s)
            for each_frame in arrived:
                # A flipped bit can make a zero: two packets to the device.
                for part in each_frame.split(b"\0"):
                    yield from self._reply(part, due)

    def _reply(self, frame: bytes, due: Sequence[Due]) -> Iterator[Step]:
        answer = b"" if self._dead or not frame else self.protocol.answer(frame)
        if not answer:
            return
        wait_s, left = self._answer.carry(answer[:-1], due, self._packets)
        if wait_s > 0:
            yield Wait(wait_s)
        for each in left:
            yield each + b"\0"

    def _restart(self, seconds: float) -> Iterator[Step]:
        self._dead = False
        self.protocol.reset((self.protocol.boot_id + 1) % 2**32)
        if seconds > 0:
            yield Wait(seconds, deaf=True)
        yield self.protocol.hello()

    def _break_lamps(self, due: Sequence[Due]) -> None:
        lasting = [each for each in due if each.fault.kind.lasts]
        for each in lasting:
            if each.fault not in self._lamps.broken:
                self._log.write(LEDS, each, self._packets)
        broken = [each.fault for each in lasting]
        if broken != self._lamps.broken:
            self._lamps.broken = broken
            self.protocol.refresh()


def _flipped(frame: bytes, due: Due) -> bytes:
    bits = np.unpackbits(np.frombuffer(frame, np.uint8))
    places = due.rng.choice(len(bits), size=min(due.fault["bits"], len(bits)), replace=False)
    bits[places] ^= 1
    return np.packbits(bits).tobytes()


def require_lights(story: Story, light_count: int, lamps: FaultyLamps) -> None:
    """SimError when a story is of lights or banks that are not there, or of another device."""
    for fault in story.faults:
        if fault.name in OF_ICL:
            raise SimError(
                f"fault {fault.name}",
                found="lights that are no server's",
                expected="ICL's server (lightstage-sim icl)",
            )
        lights = fault["lights"] if "lights" in fault.kind.fields else ()
        beyond = [light for light in lights if light >= light_count]
        if beyond:
            raise SimError(
                f"fault {fault.name}",
                field="lights",
                found=str(beyond[0]),
                expected=f"0 to {light_count - 1}",
            )
        if fault.name == "swapped-bank" and (lamps.swapped == np.arange(len(lamps.swapped))).all():
            raise SimError(
                f"fault {fault.name}",
                found="a rig without two banks of as many lights each",
                expected="horizontal and vertical lights, as many of each",
            )
