"""The state of a capture, from nothing but the lines of its journal.

The same lines give the same view, live or later; a line that lacks something changes what it can.
"""

from __future__ import annotations

import collections
import dataclasses
import statistics
import sys
import threading
import time
from collections.abc import Mapping
from typing import Any, Literal

from lightstage.counting import counted
from lightstage.operator.attendance import Decision, possible_answers
from lightstage.operator.words import (
    Mark,
    Notice,
    duration,
    names_of,
    notice_of,
    number_of,
    text_of,
)
from lightstage.printable import printable
from lightstage.resume_line import options_of
from lightstage.ways import TYPED, Ways

State = Literal[
    "idle", "triggering", "downloading", "kept", "failed", "late", "restarting", "in question"
]
AT_WORK: tuple[State, ...] = ("triggering", "downloading", "late", "restarting")
UNEXPOSED: tuple[State, ...] = ("idle", "triggering", "late")
"""What a camera is that needs the light of the pattern still."""
Phase = Literal["before", "running", "asked", "paused", "aborted", "complete", "gone"]

SHOTS_MEASURED = 9
"""Time left is from the median of so many shots, so that one slow one does not change it."""
NEWS_KEPT = 50
THERE: tuple[Mark, ...] = ("kept", "in question", "accepted")
"""Marks of photographs that are there."""
FOLLOWING, STOPPED = "\0", "\1"
"""In place of a pattern: the line holds as long as the capture runs; until it is resumed."""


@dataclasses.dataclass
class CameraView:
    """One camera: its report of itself and what it does now."""

    serial: str = ""
    model: str = ""
    battery_percent: float | None = None
    card_free_bytes: float | None = None
    state: State = "idle"


@dataclasses.dataclass(frozen=True)
class Late:
    """Cameras that did not answer yet while the others have exposed.

    Attributes:
        cameras: their names.
        lit: whether the light is still on for them.
        until_s: time.monotonic() at which it goes out or, in the dark, they are started again.
    """

    cameras: tuple[str, ...]
    lit: bool
    until_s: float | None

    def left_s(self) -> float | None:
        """Seconds until then; None where it is not known."""
        return None if self.until_s is None else max(0.0, self.until_s - time.monotonic())


class View:
    """Receives every line; several threads may give lines and read.

    Args:
        session: the session's folder, for what the operator may type.
        ways: how the operator resumes and follows a capture.

    Attributes:
        session: as given.
        lock: held while it changes; hold it to read several things that belong together.
        patterns: names in order.
        cameras: by their names, in order.
        marks: by pattern, then camera; what is missing is ``to come`` (`mark`).
        takes: number of the latest photograph by (pattern, camera), where it was taken again.
        done: patterns with all their photographs.
        pattern: what is lit; None in the dark.
        shown: what was lit last; empty before the first light.
        lights: what the LED device reported, as one line.
        acknowledged: whether it reports what is lit; None where it is not known.
        phase: what the capture does; ``asked`` waits, dark, for the operator's answer; ``gone`` was
            killed.
        options: with which the capture is resumed, from its journal.
        late: what is known of cameras that the others wait for; None where there are none.
        question: what the operator is asked about; empty where nothing is asked.
        asked: the pattern that the question is of; empty where nothing is asked.
        answers: what can be answered to it.
    """

    def __init__(self, session: str = "SESSION", ways: Ways = TYPED) -> None:
        self.session = session
        self._ways = ways
        self.lock = threading.RLock()
        self.who = ""
        self.patterns: list[str] = []
        self.cameras: dict[str, CameraView] = {}
        self.marks: dict[str, dict[str, Mark]] = {}
        self.takes: dict[tuple[str, str], int] = {}
        self.done: set[str] = set()
        self.pattern: str | None = None
        self.shown = self.asked = ""
        self._asked_of: collections.Counter[str] = collections.Counter()
        self.lights = ""
        self.acknowledged: bool | None = None
        self._news: collections.deque[tuple[Notice, str]] = collections.deque(maxlen=NEWS_KEPT)
        self.phase: Phase = "before"
        self.last_id = 0
        self._shot_s: collections.deque[float] = collections.deque(maxlen=SHOTS_MEASURED)
        self._troubled_s: collections.deque[float] = collections.deque(maxlen=SHOTS_MEASURED)
        self._trouble = False
        self._since_s: float | None = None
        self._asked_s: float | None = None
        self._late_since_s: float | None = None
        self.late: Late | None = None
        self.options: list[str] = []
        self.question: list[Notice] = []
        self.answers: tuple[Decision, ...] = ()

    @property
    def news(self) -> list[Notice]:
        """What somebody should read, oldest first: what marks do not show and was not mended."""
        return [words for words, _ in self._news]

    @property
    def kept(self) -> int:
        """Photographs that count."""
        return sum(
            mark in THERE for marks in list(self.marks.values()) for mark in list(marks.values())
        )

    def mark(self, pattern: str, camera: str) -> Mark:
        """What one photograph is."""
        return self.marks.get(pattern, {}).get(camera, "to come")

    @property
    def asked_times(self) -> int:
        """How often was asked about the pattern of the question, this time too."""
        return self._asked_of[self.asked]

    @property
    def wanted(self) -> int:
        """Photographs of the whole session."""
        return len(self.patterns) * len(self.cameras)

    def left_s(self) -> float | None:
        """Seconds left, from the shots measured; None before there is one.

        A shot in which something failed shows little of the others: it is used where there is no
        other one.
        """
        shots_s = self._shot_s or self._troubled_s
        if not shots_s:
            return None
        left = sum(pattern not in self.done for pattern in self.patterns)
        late_s = None if self.late is None else self.late.left_s()
        return left * statistics.median(shots_s) + (late_s or 0.0)

    @property
    def unlit(self) -> bool:
        """Whether the pattern's light was put out, as a line states, while a camera is late."""
        return self.late is not None and not self.late.lit

    @property
    def needs_light(self) -> bool:
        """Whether a camera has not exposed the pattern yet; the light may go out after the last."""
        waiting = any(camera.state in UNEXPOSED for camera in self.cameras.values())
        return self.pattern is not None and not self.unlit and waiting

    @property
    def over(self) -> bool:
        """Whether nothing more comes."""
        return self.phase in ("complete", "aborted", "gone")

    def gone(self) -> None:
        """No capture runs any more; one that did not report how it ended was killed."""
        with self.lock:
            if not self.over:
                self._ends("gone")

    def progress(self) -> str:
        """How far it is, as one sentence."""
        with self.lock:
            return (
                f"{self.kept} of {counted(self.wanted, 'photograph')}, {duration(self.left_s())}."
            )

    def receive(self, line: Mapping[str, Any]) -> Notice:
        """Take up a line; returns its words."""
        words = notice_of(line, self.session, self._ways)
        with self.lock:
            self.options = options_of(line) or self.options
            number = number_of(line, "id")
            self.last_id = self.last_id if number is None else int(number)
            self._trouble |= _is_trouble(line)
            take = _TAKES_UP.get(text_of(line, "event"))
            if take is not None:
                take(self, line)
            # Late cameras have a line of their own, on which the seconds run; a camera that is
            # started again shows it in its row.
            shown = text_of(line, "event") in ("shot", "waiting") or _starts_again(line)
            if words.tone != "quiet" and not shown:
                self._news.append((words, _mended_by(line)))
        return words

    def _camera(self, line: Mapping[str, Any]) -> CameraView | None:
        return self.cameras.get(text_of(line, "camera"))

    def _place(self, line: Mapping[str, Any]) -> tuple[str, str]:
        # Many lines name the same ones: one text of each is held.
        return sys.intern(text_of(line, "pattern")), sys.intern(text_of(line, "camera"))

    def _mark(self, line: Mapping[str, Any], mark: Mark, state: State) -> None:
        pattern, camera = self._place(line)
        if self.late is not None and camera in self.late.cameras:
            left = tuple(name for name in self.late.cameras if name != camera)
            self.late = dataclasses.replace(self.late, cameras=left) if left else None
        if camera in self.cameras:
            self.cameras[camera].state = state
            if pattern in self.patterns:
                self.marks.setdefault(pattern, {})[sys.intern(camera)] = mark

    def _begin(self, line: Mapping[str, Any]) -> None:
        self.who = ", ".join(filter(None, (text_of(line, "subject"), text_of(line, "expression"))))
        self.patterns = [sys.intern(name) for name in names_of(line, "sequence")]
        self.cameras = {name: CameraView() for name in names_of(line, "cameras")}
        self.phase = "running"
        self._devices(line)

    def _resume(self, line: Mapping[str, Any]) -> None:
        self.phase, self.question, self.asked, self.answers = "running", [], "", ()
        self.pattern = self._since_s = None
        self._forget(STOPPED)
        self._nobody_takes()
        self._devices(line)

    def _devices(self, line: Mapping[str, Any]) -> None:
        """What devices reported, wherever a line has it."""
        for key in ("led_device", "leds", "lights"):
            leds = line.get(key)
            if isinstance(leds, dict):
                self._leds(leds)
        for key in ("told", "cameras"):
            cameras = line.get(key)
            for name, summary in cameras.items() if isinstance(cameras, dict) else ():
                if isinstance(summary, dict) and printable(name) in self.cameras:
                    camera = self.cameras[printable(name)]
                    camera.serial = text_of(summary, "serial")
                    camera.model = text_of(summary, "model")
                    camera.battery_percent = number_of(summary, "battery_percent")
                    camera.card_free_bytes = number_of(summary, "card_free_bytes")

    def _leds(self, leds: Mapping[str, Any]) -> None:
        if isinstance(leds.get("acknowledged"), bool):
            self.acknowledged = leds["acknowledged"]
        count, firmware = number_of(leds, "light_count"), text_of(leds, "firmware")
        boot = text_of(leds, "boot_id")
        parts = [counted(round(count), "lamp") if count is not None else ""]
        parts += [f"firmware {firmware}" if firmware else "", f"boot {boot}" if boot else ""]
        self.lights = ", ".join(filter(None, parts)) or self.lights

    def _asked(self, line: Mapping[str, Any]) -> None:
        self._late_over(line)
        self.phase, self.pattern, self.late = "asked", None, None
        self._asked_s = number_of(line, "elapsed_s")
        findings_field = line.get("findings")
        findings = (
            [each for each in findings_field if isinstance(each, dict)]
            if isinstance(findings_field, list)
            else []
        )
        self.question = [notice_of({**each, "event": "finding"}) for each in findings]
        self.asked = text_of(line, "pattern")
        self._asked_of[self.asked] += 1
        self.answers = possible_answers(text_of(each, "code") for each in findings)

    def _late_over(self, line: Mapping[str, Any]) -> None:
        """The time for which a camera was waited for in the dark is no measure of what is left."""
        now_s, late_s, self._late_since_s = number_of(line, "elapsed_s"), self._late_since_s, None
        if now_s is not None and late_s is not None and self._since_s is not None:
            self._since_s += now_s - late_s

    def _answered(self, line: Mapping[str, Any]) -> None:
        self.phase, self.question, self.asked, self.answers = "running", [], "", ()
        now_s, asked_s = number_of(line, "elapsed_s"), self._asked_s
        if now_s is not None and asked_s is not None and self._since_s is not None:
            self._since_s += now_s - asked_s  # thinking is no measure of what is left

    def _waiting(self, line: Mapping[str, Any]) -> None:
        names = names_of(line, "cameras")
        lit = line.get("lit") is not False
        if not lit:
            self._late_since_s = number_of(line, "elapsed_s")
        left_s = number_of(line, "dark_in_s" if lit else "ended_in_s")
        until_s = None if left_s is None else time.monotonic() + left_s
        self.late = Late(tuple(names), lit, until_s)
        for name in names:
            if name in self.cameras:
                self.cameras[name].state = "late"

    def _lit(self, line: Mapping[str, Any]) -> None:
        self._late_over(line)
        self.phase, self.late = "running", None
        self.pattern = text_of(line, "pattern") or None
        self.shown = self.pattern or self.shown
        if isinstance(line.get("acknowledged"), bool):
            self.acknowledged = line["acknowledged"]
        if self._since_s is None:
            self._since_s = number_of(line, "elapsed_s")
        for camera in self.cameras.values():
            camera.state = "idle"

    def _trigger(self, line: Mapping[str, Any]) -> None:
        pattern, _ = self._place(line)
        names = names_of(line, "takes") or names_of(line, "cameras")
        for name in names or [text_of(line, "camera")]:
            self._mark({"pattern": pattern, "camera": name}, "now", "triggering")

    def _exposed(self, line: Mapping[str, Any]) -> None:
        self._mark(line, "now", "downloading")

    def _frame(self, line: Mapping[str, Any]) -> None:
        self._mark(line, "kept", "kept")
        take = int(number_of(line, "take") or 1)
        # An older take may come home after the one that counts.
        if take > self.takes.get(self._place(line), 1):
            self.takes[self._place(line)] = take
        camera, size = self._camera(line), number_of(line, "size")
        if camera is not None and camera.card_free_bytes is not None and size is not None:
            camera.card_free_bytes = max(0.0, camera.card_free_bytes - size)

    def _failed(self, line: Mapping[str, Any]) -> None:
        if self.mark(*self._place(line)) not in THERE:
            self._mark(line, "failed", "failed")

    def _finding(self, line: Mapping[str, Any]) -> None:
        pattern, camera = self._place(line)
        if text_of(line, "severity") not in ("retake", "refuse") or pattern not in self.patterns:
            return
        for name in [camera] if camera else list(self.cameras):
            kept = self.mark(pattern, name) in THERE
            mark: Literal["in question", "failed"] = "in question" if kept else "failed"
            self._mark({"pattern": pattern, "camera": name}, mark, mark)

    def _accepted(self, _: Mapping[str, Any]) -> None:
        """All that was in question counts: a finding may be of an earlier pattern."""
        for pattern, marks in self.marks.items():
            for name in [name for name, mark in marks.items() if mark == "in question"]:
                self._mark({"pattern": pattern, "camera": name}, "accepted", "kept")

    def _rejected(self, line: Mapping[str, Any]) -> None:
        pattern, camera = self._place(line)
        if camera in self.marks.get(pattern, {}):
            self.marks[pattern][camera] = "again"
        self.done.discard(pattern)
        # Notices of a photograph that no longer counts, which no later shot would remove.
        left = [
            item
            for item in self._news
            if item[1]
            or item[0].tone != "warning"
            or item[0].pattern != pattern
            or item[0].camera not in ("", camera)
        ]
        self._news = collections.deque(left, NEWS_KEPT)

    def _retake(self, line: Mapping[str, Any]) -> None:
        takes = line.get("takes")
        for each in takes if isinstance(takes, list) else []:
            if isinstance(each, list) and len(each) == 3:
                self._rejected({"pattern": each[0], "camera": each[1]})

    def _shot(self, line: Mapping[str, Any]) -> None:
        self.late = None
        pattern, _ = self._place(line)
        self.done.add(pattern)
        if pattern:
            self._forget(pattern)
        now_s = number_of(line, "elapsed_s")
        if now_s is not None and self._since_s is not None and now_s > self._since_s:
            (self._troubled_s if self._trouble else self._shot_s).append(now_s - self._since_s)
        self._since_s, self._trouble = now_s, False

    def _note(self, line: Mapping[str, Any]) -> None:
        text = text_of(line, "said")
        if text.startswith("paused"):
            self.phase, self.pattern = "paused", None
            self._since_s = None  # a pause is no measure of what is left
        camera = self._camera(line)
        if camera is not None and text.startswith("restarting"):
            camera.state = "restarting"
        elif camera is not None and text.startswith("started again"):
            camera.state = "idle"

    def _over(self, line: Mapping[str, Any]) -> None:
        self._ends("complete" if text_of(line, "event") == "end" else "aborted")

    def _ends(self, phase: Phase) -> None:
        self.phase, self.question, self.asked, self.answers = phase, [], "", ()
        self.pattern = self.late = None
        self._nobody_takes()
        self._forget(FOLLOWING)  # nobody can any more

    def _nobody_takes(self) -> None:
        """No camera is at work; what it had begun is taken again."""
        for camera in self.cameras.values():
            if camera.state in AT_WORK:
                camera.state = "idle"
        for marks in self.marks.values():
            marks.update({camera: "again" for camera in marks if marks[camera] == "now"})

    def _forget(self, mended: str) -> None:
        """Leave out news that this makes old: a pattern's shot, or one of the two above."""
        left = [item for item in self._news if item[1] != mended]
        self._news = collections.deque(left, NEWS_KEPT)


def _is_trouble(line: Mapping[str, Any]) -> bool:
    """Whether a line reports a failed photograph or a late camera: its shot takes longer."""
    bad = text_of(line, "severity") in ("retake", "refuse")
    return bad or text_of(line, "event") in ("failed", "waiting", "asked", "rejected")


def _starts_again(line: Mapping[str, Any]) -> bool:
    """Whether a line reports that a camera is started again, or was."""
    text = text_of(line, "said")
    return text_of(line, "event") == "note" and text.startswith(("restarting", "started again"))


def _mended_by(line: Mapping[str, Any]) -> str:
    """What makes a line old: a pattern's shot, the end, or going on; empty for nothing."""
    if text_of(line, "socket"):
        return FOLLOWING
    if text_of(line, "event") in ("aborted", "end"):
        return STOPPED  # somebody may take photographs of a finished session again
    bad = text_of(line, "severity") in ("retake", "refuse")
    if text_of(line, "event") in ("failed", "rejected", "recovered") or bad:
        return text_of(line, "pattern")
    return ""


_TAKES_UP = {
    "begin": View._begin,
    "resume": View._resume,
    "devices": View._devices,
    "asked": View._asked,
    "answered": View._answered,
    "waiting": View._waiting,
    "lit": View._lit,
    "trigger": View._trigger,
    "exposed": View._exposed,
    "frame": View._frame,
    "failed": View._failed,
    "finding": View._finding,
    "accepted": View._accepted,
    "rejected": View._rejected,
    "retake": View._retake,
    "shot": View._shot,
    "note": View._note,
    "aborted": View._over,
    "end": View._over,
}
