"""Every word that the operator reads about an event: one line, and what to do where one must.

The one place for these words; a line of the journal that lacks something still reads well. Texts
that come from devices are shown without control characters.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from lightstage.counting import counted
from lightstage.findings import accepted_in_words
from lightstage.operator.plain import cause
from lightstage.printable import printable, printable_lines
from lightstage.resume_line import options_of
from lightstage.ways import TYPED, Ways

Tone = Literal["quiet", "plain", "good", "warning", "problem", "stop"]
"""``quiet`` is seen in the picture alone; ``problem`` needs somebody; ``stop`` ends the capture."""

Mark = Literal["to come", "now", "kept", "failed", "again", "in question", "accepted"]
"""State of one pattern by one camera; ``again`` waits to be retaken, ``in question`` is kept and
may be accepted or retaken, ``accepted`` was accepted with its faults."""
Line = Mapping[str, Any]

SIGNS: dict[Tone, str] = {
    "quiet": " ",
    "plain": " ",
    "good": "+",
    "warning": "!",
    "problem": "X",
    "stop": "#",
}
"""Before a line, so that no colour is needed to distinguish it."""

LOOK = "Inspect the photograph; press r to retake it."
AGAIN = "It is retaken, or you are asked."
FINDING: dict[str, tuple[Tone, str, str]] = {
    "refuse": ("stop", "Not started", "Mend this, then start again."),
    "retake": ("problem", "Not good", AGAIN),
    "warn": ("warning", "Inspect this", LOOK),
    "note": ("plain", "Noted", ""),
}
"""By severity: tone, how the line begins, what to do where the finding does not state it."""

ON_CARD = "on-card"
"""What a note is about that names the picture which a camera took before it failed."""

MISSING = "Photographs that came are kept. If it fails again, check its cable, battery and card."
"""Shown where a photograph did not come."""
FOLLOW = "{follow}"
"""Stands for the sentence of how to follow the capture."""
FAILED = "It is tried again by itself; check its cable, battery and card if it fails again."
RESUME = "Nothing that was kept is lost. {resume}"
"""``{resume}`` stands for the sentence of how to resume it."""


@dataclasses.dataclass(frozen=True)
class Notice:
    """One line for the operator.

    Attributes:
        tone: how much it matters.
        text: what happened.
        todo: what to do; empty where nothing must be done.
        camera: whose, where it is a matter of one.
        pattern: the same of a pattern.
        code: of a finding; otherwise empty.
    """

    tone: Tone
    text: str
    todo: str = ""
    camera: str = ""
    pattern: str = ""
    code: str = ""

    def __str__(self) -> str:
        text = f"{SIGNS[self.tone]} {self.text}".strip()
        return f"{text}{'' if text.endswith(('.', '?', '!', ':')) else '.'} {self.todo}".strip()


def text_of(line: Line, name: str) -> str:
    """A field as clean text; empty where it is missing."""
    value = line.get(name)
    return "" if value is None or isinstance(value, (dict, list)) else printable(value)


def _field(line: Line, name: str) -> str:
    """A field that may have a driver's words, in plain ones."""
    # Its camera and its request are shown beside it: no need to write them twice.
    value = line.get(name)
    text = "" if value is None or isinstance(value, (dict, list)) else printable_lines(value)
    # Cut last: much of it goes.
    return printable(cause(text, text_of(line, "camera")))


def number_of(line: Line, name: str) -> float | None:
    """A finite number, or None."""
    value = line.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def names_of(line: Line, name: str) -> list[str]:
    """A list of names (or the keys of a table), as clean texts."""
    value = line.get(name)
    return [printable(item) for item in value] if isinstance(value, (list, dict)) else []


def duration(seconds: float | None) -> str:
    """Time left in words; None where it is not known."""
    if seconds is None:
        return "time left not known yet"
    if seconds < 1:
        return "nearly done"
    if seconds < 90:
        return f"about {seconds:.0f} s left"
    if seconds < 5400:
        return f"about {seconds / 60:.0f} min left"
    return f"about {seconds / 3600:.1f} h left"


def notice_of(line: Line, session: str = "SESSION", ways: Ways = TYPED) -> Notice:
    """What to show for a line of the journal.

    Args:
        line: as read; any field may be missing.
        session: the session's folder.
        ways: how whoever reads it resumes and follows that session.
    """
    event = text_of(line, "event")
    make = _WORDS.get(event)
    if make is None:
        return Notice("quiet", f"{event or 'something'} {_place(line)}".strip())
    words = make(line)
    text = words.text.replace(FOLLOW, ways.follow(session))
    if not text:
        words = dataclasses.replace(words, tone="quiet")
    todo = words.todo.replace("{resume}", ways.resume(session, options_of(line)))
    return dataclasses.replace(
        words,
        text=text,
        todo=todo,
        camera=text_of(line, "camera"),
        pattern=text_of(line, "pattern"),
        code=text_of(line, "code"),
    )


def merged(items: Sequence[Notice]) -> list[Notice]:
    """The same of several cameras, or several times, shown once: in the place of the last."""
    groups: dict[tuple[str, str, str], list[Notice]] = {}
    for item in items:
        alike = item.text.replace(item.camera, "\0") if item.camera else item.text
        key = (item.tone, alike, item.todo)
        groups[key] = [*groups.pop(key, []), item]
    whole = []
    for (_, alike, _), group in groups.items():
        cameras = ", ".join(dict.fromkeys(item.camera for item in group))
        whole.append(dataclasses.replace(group[-1], text=alike.replace("\0", cameras)))
    return whole


def _place(line: Line) -> str:
    """Pattern and camera, as far as they are known: ``x+, cam0``."""
    places = (text_of(line, "pattern"), text_of(line, "camera"))
    return ", ".join(place for place in places if place)


def _at(line: Line) -> str:
    place = _place(line)
    return f"{place}: " if place else ""


def _begin(line: Line) -> Notice:
    patterns, cameras = len(names_of(line, "sequence")), len(names_of(line, "cameras"))
    who = " ".join(filter(None, (text_of(line, "subject"), text_of(line, "expression"))))
    counts = f"{counted(patterns, 'pattern')}, {counted(cameras, 'camera')}"
    return Notice("plain", f"Session of {who or 'nobody'}: {counts}")


def _lit(line: Line) -> Notice:
    how = "lit, not acknowledged by the lights" if line.get("acknowledged") is False else "lit"
    return Notice("quiet", f"{_at(line)}{how}")


def _frame(line: Line) -> Notice:
    return Notice("quiet", f"{_at(line)}kept")


def _failed(line: Line) -> Notice:
    why = _field(line, "said") or _field(line, "found") or "no photograph"
    return Notice("warning", f"{_at(line)}{why}", FAILED)


def _finding(line: Line) -> Notice:
    severity = text_of(line, "severity")
    tone, begins, todo = FINDING.get(severity, FINDING["warn"])
    where = text_of(line, "where") or _place(line)
    found, expected = _field(line, "found"), text_of(line, "expected")
    what = f"{found or text_of(line, 'code') or 'something'}"
    obvious = text_of(line, "code") == "not-taken"
    todo = MISSING if obvious else todo
    wanted = f" (wanted: {expected})" if expected and not obvious else ""
    where = "" if what.startswith(where) else f"{where}: "
    text = f"{begins}: {where}{what}{wanted}"
    return Notice(tone, text, text_of(line, "hint") or todo)


def _recovered(line: Line) -> Notice:
    where = text_of(line, "path") or "recovered/"
    return Notice(
        "warning",
        f"{_at(line)}a photograph whose light is not certain is kept apart in {where}",
        "The pattern is retaken, or you are asked.",
    )


def _shot(line: Line) -> Notice:
    return Notice("good", f"{text_of(line, 'pattern') or 'A pattern'} done")


def _note(line: Line) -> Notice:
    if text_of(line, "socket"):
        return Notice("plain", FOLLOW)
    if text_of(line, "about") == ON_CARD:
        return Notice("plain", f"{_at(line)}it answers again, and its picture is on its card")
    text = _field(line, "said")
    if not text:  # a line of the journal's own, such as one for each file on a card
        return Notice("quiet", f"{_at(line)}{text_of(line, 'about') or 'noted'}")
    text = f"{_at(line)}{text}"
    return Notice("plain", text[:1].upper() + text[1:] if not _place(line) else text)


def _waiting(line: Line) -> Notice:
    who = ", ".join(names_of(line, "cameras")) or "A camera"
    dark_s, ended_s = number_of(line, "dark_in_s"), number_of(line, "ended_in_s")
    left = "" if ended_s is None else f" in {ended_s:.0f} s"
    if line.get("lit") is False:
        text = f"The lights are dark: {who} did not answer, and will be started again{left}"
        todo = "Then it takes the pattern again alone; you are asked if it fails again and again."
        return Notice("warning", text, todo)
    soon = "soon" if dark_s is None else f"in {dark_s:.0f} s"
    return Notice("warning", f"Waiting for {who}: the lights go dark {soon}")


def _aborted(line: Line) -> Notice:
    why = _field(line, "said") or _field(line, "why")
    # Older journals have the other two.
    if not why or why in ("Stopped by the operator.", "KeyboardInterrupt") or "'s wish" in why:
        return Notice("stop", "Stopped by the operator", RESUME)
    return Notice("stop", f"Stopped: {why}", RESUME)


def _end(line: Line) -> Notice:
    frames = number_of(line, "frames")
    count = "" if frames is None else f": {counted(round(frames), 'photograph')}"
    report = line.get("capture")
    facts: Line = report if isinstance(report, dict) else {}
    patterns, faults = number_of(facts, "accepted"), number_of(facts, "accepted_findings")
    accepted = accepted_in_words(int(patterns or 0), int(faults or 0))
    return Notice("good", f"The session is complete{count}{accepted and '; ' + accepted}")


def _accepted(line: Line) -> Notice:
    findings = line.get("findings")
    count = f" with {counted(len(findings), 'finding')}" if isinstance(findings, list) else ""
    return Notice("warning", f"{_at(line)}accepted by the operator{count}")


def _always(text: str) -> Callable[[Line], Notice]:
    return lambda _: Notice("plain", text)


def _quiet(line: Line) -> Notice:
    return Notice("quiet", f"{_at(line)}{text_of(line, 'event')}")


_WORDS: dict[str, Callable[[Line], Notice]] = {
    "begin": _begin,
    "resume": _always("The session continues where it stopped"),
    "devices": _always("Lights and cameras are checked"),
    "lit": _lit,
    "trigger": _quiet,
    "exposed": _quiet,
    "frame": _frame,
    "failed": _failed,
    "finding": _finding,
    "accepted": _accepted,
    "rejected": _quiet,
    "retake": _always("Photographs of this session are retaken"),
    "recovered": _recovered,
    "deleting": _quiet,
    "deleted": _quiet,
    "shot": _shot,
    "calibration": _always("A calibration is kept with the session"),
    "note": _note,
    "waiting": _waiting,
    "asked": _quiet,
    "answered": _quiet,
    "aborted": _aborted,
    "end": _end,
}

STATES = {
    "idle": "waits",
    "triggering": "triggering",
    "downloading": "downloading",
    "kept": "kept",
    "failed": "FAILED",
    "late": "LATE",
    "restarting": "starting again",
    "in question": "IN QUESTION",
}
"""What a camera does now."""

QUESTION = "What now?"
KEYS = {
    "retake": ("r", "this pattern again"),
    "accept": ("a", "accept as it is"),
    "pause": ("p", "pause"),
    "resume": ("c", "continue"),
    "abort": ("q", "stop, dark at once"),
    "leave": ("q", "leave (the capture continues)"),
}
"""Key and words of each request."""
ANSWERS = {"retake": "retake it", "abort": "stop now, resume later"}
"""The same as answers to the question, where they read otherwise."""
LEGEND: tuple[tuple[Mark, str], ...] = (
    ("kept", "kept"),
    ("now", "now"),
    ("again", "to retake"),
    ("failed", "failed"),
    ("in question", "in question"),
    ("accepted", "accepted"),
    ("to come", "to come"),
)
"""Marks of photographs and their words."""
HEARD = {
    "retake": "It is retaken.",
    "accept": "Accepted.",
    "pause": "It pauses, dark, after this pattern.",
    "resume": "It continues.",
    "abort": "STOPPING: lights out; photographs on their way are not lost.",
}
"""Shown when a key is heard."""


def heard_words(do: str, pattern: str = "") -> str:
    """What is shown when a key is heard.

    Args:
        do: a request.
        pattern: that a retake is of, which may be under way or over; empty for an answer.
    """
    if do == "retake" and pattern:
        return f"{pattern} will be retaken next."
    return HEARD[do]
