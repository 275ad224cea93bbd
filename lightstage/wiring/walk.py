"""A walk through the lamps of a rig: which one is lit, on which channel, what was corrected."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping

import numpy as np

from lightstage.rig import LightAddress, Rig

HELP = (
    "Enter or n next, b back, d dark, q end; with Enter: a number that lamp, c NUMBER its "
    "channel, s NUMBER the lamp that shines instead: "
)
STEPS = ("n", "b", "d", "q")
"""What one key does; the others want a number."""
_SAID = re.compile(r"([a-z?]*)\s*([0-9]{0,10})")


@dataclasses.dataclass
class Walk:
    """Where somebody is who inspects one lamp after the other.

    Attributes:
        rig: with the addresses as they are now.
        counts: channels of each device, by its controller's name.
        at: place in the rig of the light that is meant.
        lit: whether it shall shine.
        over: whether the walk has ended.
    """

    rig: Rig
    counts: Mapping[str, int]
    at: int = 0
    lit: bool = True
    over: bool = False

    def state(self) -> str:
        """The lamp that is meant: name, place, address."""
        light, address = self.rig.lights[self.at], self.rig.addresses[self.at]
        return (
            f"Lamp {light.id} ({light.name}), {self.at + 1} of {len(self.rig.lights)}: "
            f"{place_in_words(np.array(light.position_mm))}; "
            f"channel {address.channel} of {address.controller}"
        )

    def hear(self, line: str) -> str:
        """Do what an operator's line asks for.

        Returns:
            What was done or could not be, in words; empty where the lamp that is meant now
            shows it.
        """
        parts = _SAID.fullmatch(line.strip().lower())
        word, number = (parts[1], parts[2]) if parts else ("", "?")
        moves = {"": 1, "n": 1, "b": -1}
        if word in moves and not number:
            self.at = (self.at + moves[word]) % len(self.rig.lights)
        elif parts and not word:
            return self._go_to(int(number))
        elif word == "c" and number:
            own = self.rig.addresses[self.at]
            return self._connect(self.at, LightAddress(int(number), own.controller))
        elif word == "s" and number:
            other = self._place_of(int(number))
            if other is None:
                return self._no_light(int(number))
            return self._connect(other, self.rig.addresses[self.at])
        elif word == "d" and not number:
            self.lit = False
            return "Dark."
        elif word == "q" and not number:
            self.over = True
            return ""
        else:
            return f"Not understood: {line.strip()[:40]!r}."
        self.lit = True
        return ""

    def _go_to(self, light_id: int) -> str:
        place = self._place_of(light_id)
        if place is None:
            return self._no_light(light_id)
        self.at, self.lit = place, True
        return ""

    def _place_of(self, light_id: int) -> int | None:
        found = (i for i, light in enumerate(self.rig.lights) if light.id == light_id)
        return next(found, None)

    def _no_light(self, light_id: int) -> str:
        ids = [light.id for light in self.rig.lights]
        return f"No lamp {light_id}: the rig has ids from {min(ids)} to {max(ids)}."

    def _connect(self, place: int, wire: LightAddress) -> str:
        """Give a lamp a wire; the lamp that had it gets the first one's, so none is double."""
        count = self.counts[wire.controller]
        if wire.channel >= count:
            return f"No {self._wire(wire)}: there are {count}, counted from 0."
        wires = list(self.rig.addresses)
        light, before = self.rig.lights[place], wires[place]
        self.lit = True
        if before == wire:
            return f"Lamp {light.id} ({light.name}) is on {self._wire(wire)} already."
        text = f"Lamp {light.id} ({light.name}) is on {self._wire(wire)} now"
        if wire in wires:
            other = wires.index(wire)
            wires[other] = before
            text += f", and lamp {self.rig.lights[other].id} on {self._wire(before)}"
        wires[place] = wire
        self.rig = self.rig.readdressed(wires)
        return f"{text}."

    def _wire(self, wire: LightAddress) -> str:
        """A channel in words, with its controller where there are several."""
        of = f" of {wire.controller}" if len(self.counts) > 1 else ""
        return f"channel {wire.channel}{of}"


def place_in_words(position_mm: np.ndarray) -> str:
    """Where a lamp is, as somebody sees it who is at the frontal camera.

    Args:
        position_mm: (3,) in the world.
    """
    x, y, z = position_mm
    around = round(float(np.degrees(np.arctan2(x, z))))
    up = round(float(np.degrees(np.arcsin(y / np.linalg.norm(position_mm)))))
    side = "straight ahead" if around == 0 else f"{abs(around)} degrees to the right"
    if around < 0:
        side = side.replace("right", "left")
    if abs(around) > 90:
        side += " (behind the person)"
    return f"{side}, {abs(up)} degrees {'up' if up >= 0 else 'down'}"


def corrections(before: Rig, after: Rig) -> list[str]:
    """Each lamp whose address changed, in words."""
    pairs = zip(before.lights, before.addresses, after.addresses, strict=True)
    return [
        f"lamp {light.id} ({light.name}): channel {was.channel} -> {now.channel}"
        if was.controller == now.controller
        else f"lamp {light.id} ({light.name}): channel {was.channel} of {was.controller} -> "
        f"{now.channel} of {now.controller}"
        for light, was, now in pairs
        if was != now
    ]
