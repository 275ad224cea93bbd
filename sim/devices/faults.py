"""Faults as a story: named, scripted or drawn from a seed, and logged.

A story is a list of faults. Each has a name (sim/devices/fault_names.py, docs/faults.md) and states
when it happens: at the n-th packet, opening or shot, from there until another, or with a
probability. What is drawn depends on the story's seed, the device, the fault's place in the story
and the count alone: the same story happens twice, also in a camera process that was killed and
started again.
"""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import json
import os
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.formats.config import read_toml
from lightstage.formats.values import read_lines
from sim.devices.fault_names import FIELDS, LEDS, NAMES, Counted, FaultName
from sim.errors import SimError

if TYPE_CHECKING:
    import numpy as np

WHEN = ("at", "until", "probability")


class Fault:
    """One event of a story, such as ``Fault("stale", camera="cam3", at=2)``.

    Args:
        name: of NAMES.
        fields: `at`, `until` (counted from 1), `probability`, `camera` (every one where absent),
            and the name's own. Without `until` a fault that lasts continues for ever, one that does
            not happens once; with a probability and no `at` it may happen each time.

    Raises:
        SimError: an unknown name or field, or a value out of range; the known ones are listed.
    """

    def __init__(self, name: str, /, **fields: Any) -> None:
        if not isinstance(name, str) or name not in NAMES:
            raise SimError(
                "fault",
                field="name",
                found=repr(name),
                expected=f"one of {', '.join(sorted(NAMES))}",
            )
        self.name = name
        self.kind: FaultName = NAMES[name]
        place = f"fault {name}"
        known = [*WHEN, *(("camera",) if self.kind.device == "camera" else ()), *self.kind.fields]
        for key, value in fields.items():
            if key not in known:
                raise SimError(
                    place,
                    field=key,
                    found="an unknown field",
                    expected=f"one of {', '.join(known)}",
                )
            expected, holds = FIELDS[key]
            if not holds(value):
                raise SimError(place, field=key, found=repr(value), expected=expected)
        self.fields = fields
        self.probability = float(fields.get("probability", 1.0))
        self.at = int(fields.get("at", 1))
        once = not self.kind.lasts and ("at" in fields or "probability" not in fields)
        self.until: int | None = fields.get("until", self.at if once else None)
        if self.until is not None and self.until < self.at:
            raise SimError(
                place, field="until", found=str(self.until), expected=f"{self.at} or more"
            )

    def __getitem__(self, key: str) -> Any:
        """A field of the name's own, or its default."""
        return self.fields.get(key, self.kind.fields[key])

    def __repr__(self) -> str:
        fields = "".join(f", {key}={value!r}" for key, value in self.fields.items())
        return f"Fault({self.name!r}{fields})"

    def concerns(self, device: str, counted: Counted) -> bool:
        """Whether it is of this device (``leds``, or a camera's name) and counted so."""
        if self.kind.counted != counted or (self.kind.device == LEDS) != (device == LEDS):
            return False
        return device == LEDS or self.fields.get("camera", device) == device

    def as_dict(self) -> dict[str, Any]:
        """Its entry in a story file."""
        return {"name": self.name, **self.fields}


@dataclasses.dataclass(frozen=True)
class Due:
    """A fault whose time has come, with the randomness that is its own this time."""

    fault: Fault
    rng: np.random.Generator

    @property
    def name(self) -> str:
        """The fault's name."""
        return self.fault.name


class Story:
    """Faults in the order in which they were written.

    Args:
        faults: that may happen.
        seed: of what is drawn.
    """

    def __init__(self, faults: Iterable[Fault] = (), seed: int = 0) -> None:
        self.faults = tuple(faults)
        self.seed = seed

    @staticmethod
    def from_dict(value: Mapping[str, Any], where: str | Path) -> Story:
        """A story from ``seed`` and a list ``fault`` of tables; SimError on anything else."""
        unknown = [key for key in value if key not in ("seed", "fault")]
        if unknown:
            raise SimError(
                where, field=unknown[0], found="an unknown key", expected="seed or [[fault]]"
            )
        seed, entries = value.get("seed", 0), value.get("fault", [])
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            raise SimError(where, field="seed", found=repr(seed), expected="a whole number from 0")
        if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
            raise SimError(where, field="fault", found=repr(entries), expected="[[fault]] tables")
        faults = []
        for number, entry in enumerate(entries, 1):
            fields = dict(entry)
            try:
                faults.append(Fault(fields.pop("name", ""), **fields))
            except SimError as error:
                raise SimError(
                    f"{where}, [[fault]] {number}",
                    field=" ".join((error.where, error.field)),
                    found=error.found,
                    expected=error.expected,
                ) from None
        return Story(faults, seed)

    @staticmethod
    def read(path: Path) -> Story:
        """A story file (TOML): ``seed`` and one ``[[fault]]`` table each.

        Raises:
            SimError, ConfigError: no file, no TOML, or what Fault refuses.
        """
        return Story.from_dict(read_toml(path), path)

    def as_dict(self) -> dict[str, Any]:
        """What `from_dict` reads."""
        return {"seed": self.seed, "fault": [fault.as_dict() for fault in self.faults]}

    def check_cameras(self, camera_ids: Sequence[str], where: str | Path = "story") -> None:
        """SimError when a fault names a camera that is not there."""
        for fault in self.faults:
            camera = fault.fields.get("camera")
            if camera is not None and camera not in camera_ids:
                raise SimError(
                    f"{where}, {fault.name}",
                    field="camera",
                    found=repr(camera),
                    expected=f"one of {', '.join(camera_ids)}",
                )

    def due(self, device: str, counted: Counted, count: int) -> list[Due]:
        """The faults that happen to a device at this packet, opening or shot.

        Args:
            device: ``leds`` or a camera's name.
            counted: what has just been counted.
            count: how many there were, this one included.
        """
        found = []
        for number, fault in enumerate(self.faults):
            if not fault.concerns(device, counted) or count < fault.at:
                continue
            if fault.until is not None and count > fault.until:
                continue
            rng = self._rng(number, device, count)
            if fault.probability >= 1.0 or rng.random() < fault.probability:
                found.append(Due(fault, rng))
        return found

    def _rng(self, number: int, device: str, count: int) -> np.random.Generator:
        import numpy as np  # a camera's process without a fault starts sooner

        digest = hashlib.sha256(f"{number} {device} {count}".encode()).digest()
        return np.random.default_rng([self.seed, *np.frombuffer(digest, "<u4").tolist()])


@dataclasses.dataclass(frozen=True)
class Happening:
    """One thing that went wrong.

    Attributes:
        time_utc: ISO 8601, to the millisecond.
        device: ``leds`` or a camera's name.
        name: the fault's.
        counted: packet, open or shot.
        count: which one.
        detail: what exactly, in words; may be empty.
    """

    time_utc: str
    device: str
    name: str
    counted: str
    count: int
    detail: str


class FaultLog:
    """What happened: kept, and appended to a file where one is given.

    Several threads and processes may write to one file: each line is one write at its end.

    Args:
        path: file of one JSON object a line.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.happened: list[Happening] = []
        self._lock = threading.Lock()

    def write(self, device: str, due: Due, count: int, detail: str = "") -> None:
        """Note that a fault happened now."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        happening = Happening(now, device, due.name, due.fault.kind.counted, count, detail)
        with self._lock:
            self.happened.append(happening)
            if self.path is not None:
                handle = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
                try:
                    os.write(handle, json.dumps(dataclasses.asdict(happening)).encode() + b"\n")
                finally:
                    os.close(handle)

    def names(self, device: str | None = None) -> list[str]:
        """Names in order, of one device or all."""
        return [each.name for each in self.happened if device in (None, each.device)]


def read_fault_log(path: Path) -> list[Happening]:
    """What a FaultLog wrote, in order; nothing where no fault happened.

    Raises:
        SimError: a line that is none of its own.
    """
    if not path.is_file():
        return []
    happenings = []
    for number, value in enumerate(read_lines(path), 1):
        try:
            happenings.append(Happening(**value))
        except TypeError as error:
            raise SimError(
                path, field=f"line {number}", found=str(error), expected="a happening"
            ) from None
    return happenings
