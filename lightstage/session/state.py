"""The state of a session by its journal: kept, outstanding, still wanted. Built line by line.

No line is held: of each photograph only what recovery asks for, so that a session of very many
shots stays small in memory. The rest is in the journal on the disk.
"""

from __future__ import annotations

import dataclasses
import sys
import threading
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from lightstage.cameras.camera import CardFile
from lightstage.session.events import Line
from lightstage.session.photo_entry import Kept, Key, Recovered, key_of, packed, stem_of

NOT_OURS = "not-ours"
"""What a note is about that names a file on a card as another session's."""
CLOCK_SET = "clock-set"
"""What a note is about that names a photograph which was taken while its camera's clock was set."""
NOT_HELD = ("levels", "cards")
"""What is long in a journal's first line, and not needed here."""


@dataclasses.dataclass(frozen=True, slots=True)
class Exposed:
    """A photograph that was taken under a light that lasted.

    Attributes:
        pattern: what was lit.
        camera: who took it.
        take: 1, or more where it was taken again.
        file: on the camera's card.
        beside: other files of the same shot, such as a JPEG.
        acknowledged: whether the lights reported that they were lit; None where it is not known.
        time_utc: when it was reported, by this computer's clock; empty where it is not known.
        lasted_s: from its trigger until the camera reported that the photograph was there.
        clock_offset_s: the camera's clock less this computer's then; None where it is not known.
    """

    pattern: str
    camera: str
    take: int
    file: CardFile
    beside: tuple[CardFile, ...] = ()
    acknowledged: bool | None = None
    time_utc: str = ""
    lasted_s: float = 0.0
    clock_offset_s: float | None = None

    @property
    def key(self) -> Key:
        """Pattern, camera, take."""
        return (self.pattern, self.camera, self.take)


class SessionState:
    """What the lines of a journal add up to; several threads may ask while lines come.

    Args:
        lines: from ``begin`` on.

    Attributes:
        begin: the first line, without the levels and what was on the cards.
        patterns: of the sequence, in order.
        cameras: ids, in the rig's order.
        serials: of the cameras, as they reported them at the beginning; None where one cannot.
        ended: whether the session was finished.
    """

    def __init__(self, lines: Iterable[Line]) -> None:
        iterator = iter(lines)
        begin = next(iterator)
        self.begin: Line = {name: begin[name] for name in begin if name not in NOT_HELD}
        self.patterns: tuple[str, ...] = tuple(self.begin["sequence"])
        self.cameras: tuple[str, ...] = tuple(self.begin["cameras"])
        self.serials: Mapping[str, str | None] = self.begin.get("serials") or {}
        self.ended = False
        self._lock = threading.RLock()
        self._baseline: dict[str, set[CardFile]] = {c: set() for c in self.cameras}
        self._since: dict[str, list[CardFile]] = {c: [] for c in self.cameras}
        self._gone: dict[str, set[CardFile]] = {c: set() for c in self.cameras}
        self._lit: dict[str, bool | None] = {}
        self._outstanding: dict[str, tuple[str, int]] = {}
        self._takes: dict[tuple[str, str], int] = {}  # intended, and not kept yet
        self._exposed: dict[Key, Exposed] = {}
        self._frames: list[Kept] = []
        self._named: dict[str, dict[str, Kept]] = {}  # by pattern, then stem: shared by patterns
        self._by_hash: dict[bytes, Kept] = {}
        self._rejected: set[Key] = set()
        self._recovered: dict[str, Recovered] = {}
        self._deleting: dict[str, dict[CardFile, str]] = {c: {} for c in self.cameras}
        self._shots: set[str] = set()
        self._calibration: dict[str, Any] = {}
        self._snapshot(begin)
        self._on_calibration(self.begin.get("calibration") or {})
        for line in iterator:
            self.apply(line)

    def apply(self, line: Line) -> None:
        """Take one more line of the journal."""
        with self._lock:
            taking = getattr(self, f"_on_{line['event']}", None)
            if taking is not None:
                taking(line)

    # -- what may be asked

    def accepted(self, pattern: str, camera: str) -> Kept | None:
        """The photograph that counts: of the last take that was not rejected."""
        with self._lock:
            for take in range(self.next_take(pattern, camera) - 1, 0, -1):
                key = (pattern, camera, take)
                kept = self._kept(key)
                if kept is not None and key not in self._rejected:
                    return kept
        return None

    def missing(self, pattern: str) -> tuple[str, ...]:
        """Cameras without a photograph of this pattern that counts."""
        return tuple(c for c in self.cameras if self.accepted(pattern, c) is None)

    def is_done(self, pattern: str) -> bool:
        """Whether all photographs are there and the shot was finished."""
        with self._lock:
            return pattern in self._shots and not self.missing(pattern)

    def wanted(self) -> dict[str, tuple[str, ...]]:
        """Cameras that must still take each pattern; () where only its ``shot`` line is wanted.

        A pattern that is not in it is done.
        """
        return {p: self.missing(p) for p in self.patterns if not self.is_done(p)}

    def next_take(self, pattern: str, camera: str) -> int:
        """Number of the next take; one that was once intended is never used again."""
        with self._lock:
            named = self._named.get(pattern, {}).values()
            intended = self._takes.get((pattern, camera), 0)
            return max([intended, *(each.take for each in named if each.camera == camera)]) + 1

    def frames(self) -> list[Kept]:
        """Photographs of all takes that were not rejected, in the order of keeping."""
        with self._lock:
            return [kept for kept in self._frames if kept.key not in self._rejected]

    def all_frames(self) -> list[Kept]:
        """Photographs of all takes, rejected ones too."""
        with self._lock:
            return list(self._frames)

    def is_kept(self, key: Key) -> bool:
        """Whether a take's photograph is kept, counting or not."""
        with self._lock:
            return self._kept(key) is not None

    def recovered(self) -> dict[str, Recovered]:
        """Files of uncertain light or label, by their path in the session."""
        with self._lock:
            return dict(self._recovered)

    def whose(self, sha256: str) -> Key | None:
        """The take whose photograph has these bytes, a rejected one's too; None for nobody's."""
        with self._lock:
            kept = self._by_hash.get(packed(sha256))
            return None if kept is None else kept.key

    def outstanding(self, camera: str) -> tuple[str, int] | None:
        """Pattern and take that a camera was to take and of which no exposure is known."""
        with self._lock:
            return self._outstanding.get(camera)

    def unsettled(self, camera: str) -> list[Exposed]:
        """Exposures of which no photograph is kept and which were not given up."""
        with self._lock:
            return [
                each
                for key, each in self._exposed.items()
                if each.camera == camera and key not in self._rejected and not self.is_kept(key)
            ]

    def exposure(self, key: Key) -> Exposed | None:
        """What was exposed for a take of which no photograph is kept yet."""
        with self._lock:
            return self._exposed.get(key)

    def on_card(self, camera: str) -> set[CardFile]:
        """Files that must be on a camera's card if nobody touched it."""
        with self._lock:
            return self.known(camera) - set(self._deleting[camera])

    def known(self, camera: str) -> set[CardFile]:
        """Files of a camera's card of which the journal knows what they are."""
        with self._lock:
            return self._baseline[camera].union(self._since[camera]) - self._gone[camera]

    def deleting(self, camera: str) -> dict[CardFile, str]:
        """Files whose deletion was begun and of which no end is known, with their pattern."""
        with self._lock:
            return dict(self._deleting[camera])

    def acknowledged(self, pattern: str) -> bool | None:
        """Whether the lights reported that a pattern was lit when it last was; None: not known."""
        with self._lock:
            return self._lit.get(pattern)

    def is_shot(self, pattern: str) -> bool:
        """Whether a pattern's shot was finished, and no photograph rejected after it."""
        with self._lock:
            return pattern in self._shots

    def calibration(self) -> dict[str, Any]:
        """Calibration files of the session, by kind."""
        with self._lock:
            return dict(self._calibration)

    # -- what each event changes

    def _snapshot(self, line: Line) -> None:
        for camera, files in (line.get("cards") or {}).items():
            if camera in self._baseline:
                self._baseline[camera] = card_files(files)
                self._since[camera], self._gone[camera] = [], set()
                self._deleting[camera] = {}

    def _on_resume(self, line: Line) -> None:
        if self.ended:
            # All that was this session's came home at its end: what its cards have since is not.
            self._snapshot(line)
            self.ended = False

    def _on_retake(self, line: Line) -> None:
        for pattern, camera, take in line["takes"]:
            self._reject((pattern, camera, take))

    def _on_lit(self, line: Line) -> None:
        self._lit[sys.intern(line["pattern"])] = line.get("acknowledged")

    def _on_trigger(self, line: Line) -> None:
        for camera, take in line["takes"].items():
            self._outstanding[camera] = (line["pattern"], take)
            self._note_take(line["pattern"], camera, take)

    def _on_exposed(self, line: Line) -> None:
        exposed = Exposed(
            *key_of(line),
            CardFile(*line["file"]),
            tuple(CardFile(*each) for each in line.get("beside") or ()),
            self._lit.get(line["pattern"]),
            line["time_utc"],
            line.get("exposure_s", 0.0),
            line.get("clock_offset_s"),
        )
        self._exposed[exposed.key] = exposed
        self._outstanding.pop(exposed.camera, None)
        self._note_take(*exposed.key)
        self._add_files(exposed.camera, (exposed.file, *exposed.beside))

    def _on_frame(self, line: Line) -> None:
        key = key_of(line)
        exposed = self._exposed.pop(key, None)
        kept = Kept.of(line, None if exposed is None else exposed.file)
        if (before := self._kept(key)) is not None:
            self._frames.remove(before)
        self._frames.append(kept)
        self._named.setdefault(kept.pattern, {})[sys.intern(stem_of(*key[1:]))] = kept
        self._by_hash.setdefault(kept.digest, kept)
        if self._takes.get(key[:2], 0) <= kept.take:
            self._takes.pop(key[:2], None)

    def _on_rejected(self, line: Line) -> None:
        self._reject(key_of(line))

    def _reject(self, key: Key) -> None:
        counted = self.accepted(key[0], key[1])
        self._rejected.add(key)
        if counted is not None and counted.key == key:
            self._shots.discard(key[0])
        if self._outstanding.get(key[1]) == (key[0], key[2]):
            del self._outstanding[key[1]]

    def _on_recovered(self, line: Line) -> None:
        file = None if line.get("file") is None else CardFile(*line["file"])
        self._recovered[line["path"]] = Recovered(line["path"], line["sha256"], file)
        if file is not None:
            self._add_files(line["camera"], (file,))

    def _on_deleting(self, line: Line) -> None:
        self._deleting[line["camera"]][CardFile(*line["file"])] = line["pattern"]

    def _on_deleted(self, line: Line) -> None:
        file = CardFile(*line["file"])
        self._deleting[line["camera"]].pop(file, None)
        self._gone[line["camera"]].add(file)

    def _on_shot(self, line: Line) -> None:
        self._shots.add(sys.intern(line["pattern"]))

    def _on_calibration(self, line: Line) -> None:
        kinds = ("colour", "cameras", "lights", "flats")
        self._calibration |= {kind: line[kind] for kind in kinds if kind in line}

    def _on_note(self, line: Line) -> None:
        if line.get("about") == "card":
            self._snapshot(line)
        if line.get("about") == NOT_OURS and line.get("camera") in self._since:
            self._add_files(line["camera"], card_files([line["file"]]))

    def _on_end(self, _: Line) -> None:
        self.ended = True

    def _note_take(self, pattern: str, camera: str, take: int) -> None:
        self._takes[pattern, camera] = max(take, self._takes.get((pattern, camera), 0))

    def _kept(self, key: Key) -> Kept | None:
        return self._named.get(key[0], {}).get(stem_of(*key[1:]))

    def _add_files(self, camera: str, files: Collection[CardFile]) -> None:
        self._since[camera] += files
        self._gone[camera] -= set(files)  # a name comes again after a card was emptied


def card_files(files: Iterable[Sequence[Any]]) -> set[CardFile]:
    """Files of a card as a journal has them: name and size."""
    return {CardFile(str(name), int(size)) for name, size in files}
