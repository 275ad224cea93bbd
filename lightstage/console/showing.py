"""The values that the templates show, made from a session's state."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from typing import Any, NamedTuple

from lightstage.checks.sums import Sum
from lightstage.console.following import Followed
from lightstage.console.pictures import BINS, Facts, Focus
from lightstage.console.runner import JobState
from lightstage.console.sums import SumFacts
from lightstage.counting import counted
from lightstage.day import Planned
from lightstage.errors import FormatError
from lightstage.findings import two_digits
from lightstage.formats.values import parse_json
from lightstage.operator.view import Phase, View
from lightstage.operator.words import (
    ANSWERS,
    KEYS,
    LEGEND,
    STATES,
    Mark,
    duration,
    merged,
    notice_of,
    text_of,
)
from lightstage.session.opening import JOURNAL

NEWS_SHOWN = 6
QUESTION_PHOTOGRAPHS = 9
"""Number of photographs, at most, beside a question."""
SAME_IN_ALL = ("pulses-unknown",)
"""Codes of findings that every session has; the page of devices shows them."""
SHARP = 0.9
"""Ratio of fine detail to another photograph of the camera below which the page warns: a tenth less
is seen at once, and the checks' own limits decide what is retaken."""

MARKS: dict[Mark, str] = {
    "to come": "·",
    "now": "…",
    "kept": "✓",
    "failed": "X",
    "again": "r",
    "in question": "!",
    "accepted": "a",
}
"""Signs of photographs, which need no colour."""

BANNERS: dict[Phase, tuple[str, str]] = {
    "before": ("…", "NOT BEGUN"),
    "running": ("○", "DARK, at work"),
    "asked": ("?", "DARK, WAITING FOR YOU"),
    "paused": ("‖", "PAUSED, dark"),
    "aborted": ("■", "STOPPED, dark"),
    "complete": ("✓", "COMPLETE"),
    "gone": ("✕", "THE CAPTURE WAS KILLED"),
}
"""Sign and words of each phase; those of ``running`` are for a moment when nothing is lit."""


class Cell(NamedTuple):
    """One photograph's place in the table."""

    camera: str
    mark: Mark
    sign: str
    take: int
    there: bool


class Row(NamedTuple):
    """One pattern of the table; `place` is its number in the sequence."""

    place: int
    pattern: str
    lit: bool
    done: bool
    cells: list[Cell]


class Action(NamedTuple):
    """A button and its key.

    Attributes:
        do: the request.
        key: its key.
        words: text on the button.
        pattern: the pattern that is meant; empty where none is.
        answer: whether it answers a question.
    """

    do: str
    key: str
    words: str
    pattern: str = ""
    answer: bool = False


class Person(NamedTuple):
    """A subject of the plan, with the numbers of expressions and sessions."""

    subject: str
    consent: str
    expressions: int = 0
    sessions: int = 0

    def having(self, planned: Planned) -> Person:
        """The same with one take more."""
        sessions = self.sessions + len(planned.sessions)
        return self._replace(expressions=self.expressions + 1, sessions=sessions)


class Doubt(NamedTuple):
    """Findings of a question for which the same should be done."""

    texts: list[str]
    todo: str


def desk_values(followed: Followed, state: JobState | None, most_rows: int) -> dict[str, Any]:
    """What the live view shows of a session.

    Args:
        followed: the session, up to date.
        state: the page's own job in it; None where there is none.
        most_rows: number of patterns that are shown at a time.
    """
    view = followed.view
    with view.lock:
        rows = _rows(followed, most_rows)
        sign, words = BANNERS[view.phase]
        starting = is_starting(followed, state)
        if starting:
            sign, words = "…", "STARTING"
        if view.phase == "running" and view.pattern is not None and not view.unlit:
            # Where all have exposed, the light may be out while they are read.
            sign, words = "●", f"{'LIT' if view.needs_light else 'TAKING'}: {view.pattern}"
        left = "" if view.over else duration(view.left_s())
        late = ""
        if view.late is not None:
            seconds = view.late.left_s()
            who = ", ".join(view.late.cameras)
            ends = "until the light goes out" if view.late.lit else "until it is started again"
            late = f"Waiting for {who}" + ("" if seconds is None else f": {seconds:.0f} s {ends}")
        doubts, photographs = _question(followed)
        asked = {each.text for each in view.question}
        news = [
            item
            for item in reversed(merged(view.news))
            # The list of what happened, below, has the plain lines.
            if item.tone != "plain" and item.text not in asked and item.code not in SAME_IN_ALL
        ]
        return {
            "name": followed.root.name,
            "who": view.who,
            "take": take_of(followed.root.name),
            "phase": "starting" if starting else view.phase,
            "starting": starting,
            "sign": sign,
            "words": words,
            "kept": view.kept,
            "wanted": view.wanted,
            "done": len(view.done),
            "patterns": len(view.patterns),
            "left": left,
            "late": late,
            "lights": view.lights,
            "unacknowledged": view.acknowledged is False,
            "question": doubts,
            "asked": view.asked,
            "times": view.asked_times,
            "photographs": photographs,
            "news": [] if starting else news[:NEWS_SHOWN],
            "cameras": [
                {
                    "id": name,
                    "state": STATES[camera.state],
                    "battery": camera.battery_percent,
                    "bad": camera.state in ("failed", "late", "restarting", "in question"),
                }
                for name, camera in view.cameras.items()
            ],
            "rows": rows,
            "hidden": len(view.patterns) - len(rows),
            "actions": actions(view, followed.live, starting),
            "live": followed.live,
            "job": state,
            "problem": state.output if state is not None and state.failed else "",
            "resumable": view.phase in ("aborted", "gone") and not (followed.live or starting),
            "marks": [(MARKS[mark], words) for mark, words in LEGEND],
            "last_id": view.last_id,
        }


def _question(followed: Followed) -> tuple[list[Doubt], list[tuple[str, Cell]]]:
    """The findings of a question, by what to do, and its photographs with their patterns."""
    view = followed.view
    doubts: dict[str, Doubt] = {}
    concerned: dict[tuple[str, str], None] = {}
    for item in merged(view.question):
        doubts.setdefault(item.todo, Doubt([], item.todo)).texts.append(item.text)
    for item in view.question:
        for camera in [item.camera] if item.camera else list(view.cameras):
            concerned[item.pattern or view.asked, camera] = None
    cells = [(pattern, _cell(followed, pattern, camera)) for pattern, camera in concerned]
    return list(doubts.values()), [each for each in cells if each[1].there][:QUESTION_PHOTOGRAPHS]


def take_of(folder: str) -> int:
    """Number of a take, from its folder's name (`lightstage.day.plan.take_folder`)."""
    number = folder.split("+")[2:3]
    return int(number[0]) if number and number[0].isdecimal() else 1


def _rows(followed: Followed, most: int) -> list[Row]:
    """Rows of patterns in order: all, or the latest and the bad ones where there are more."""
    view = followed.view
    patterns = view.patterns
    if len(patterns) > most:
        begun = [p for p in patterns if view.marks.get(p)]
        bad = [p for p in begun if {"failed", "in question", "again"} & set(view.marks[p].values())]
        chosen = {*bad[-most:], *begun[-most:], *patterns[:1]}
        patterns = [p for p in patterns if p in chosen]
    return [
        Row(
            view.patterns.index(pattern),
            pattern,
            view.pattern == pattern,
            pattern in view.done,
            [_cell(followed, pattern, camera) for camera in view.cameras],
        )
        for pattern in patterns
    ]


def _cell(followed: Followed, pattern: str, camera: str) -> Cell:
    mark = followed.view.mark(pattern, camera)
    photograph = followed.photograph(pattern, camera)
    take = 1 if photograph is None else photograph.take
    return Cell(camera, mark, MARKS[mark], take, photograph is not None)


def is_starting(followed: Followed, state: JobState | None) -> bool:
    """Whether a capture has been started in a session that is over, and has not begun to write.

    Args:
        followed: the session.
        state: the page's own job in it.
    """
    if state is None or not state.running or not followed.view.over:
        return False
    try:
        written_s = (followed.root / JOURNAL).stat().st_mtime
    except OSError:
        return False
    return written_s < state.started_s  # else the journal is complete, and devices are released


def actions(view: View, live: bool, starting: bool = False) -> list[Action]:
    """The requests that are possible now, with the same keys as in the terminal."""
    if view.over and not starting:
        return []
    if not live or starting:  # its socket is not known yet, but a stop is possible
        return [Action("abort", *KEYS["abort"])]
    if view.phase == "asked":
        return [
            Action(do, KEYS[do][0], ANSWERS.get(do, KEYS[do][1]), view.asked, True)
            for do in view.answers
        ]
    wanted: Sequence[str] = ("resume" if view.phase == "paused" else "pause", "abort")
    retake = Action("retake", KEYS["retake"][0], f"retake {view.shown}", view.shown)
    # Once all are done the capture ends by itself; each photograph then has a button of its own.
    again = [retake] if view.shown and 0 < len(view.done) < len(view.patterns) else []
    return [*again, *(Action(do, *KEYS[do]) for do in wanted)]


def look_values(facts: Facts) -> dict[str, Any]:
    """The sentences and curves beside a large picture."""
    sentences = [
        f"{facts.width_px} x {facts.height_px} pixels.",
        _clipped_words(facts.clipped),
        f"The brightest percent is at {two_digits(100 * facts.brightest)} % of white, the mean at "
        f"{two_digits(100 * facts.mean)} %.",
    ]
    return {"sentences": sentences, "curves": _curves(facts.histogram)}


def _clipped_words(shares: tuple[float, float, float] | None) -> str:
    if shares is None:
        return "Whether pixels are clipped is not known: this photograph was developed already."
    if max(shares) == 0:
        return "Nothing is clipped."
    red, green, blue = (two_digits(100 * share) for share in shares)
    return (
        f"Clipped (painted in stripes): red {red} %, green {green} %, blue {blue} % of the pixels "
        "read."
    )


def focus_words(focus: Focus, other: str) -> list[str]:
    """How sharp a photograph is, in sentences; `other` is the pattern that it was compared with."""
    if focus.figure is None:
        return ["Focus: not known; the subject shows too little fine detail here."]
    figure = two_digits(focus.figure)
    sentences = [f"Focus figure {figure}: fine detail over coarse; higher is sharper."]
    if focus.against is not None:
        beside = f"this camera's photograph of {other} (ratio {two_digits(focus.against)})"
        sentences.append(
            f"As sharp as {beside}."
            if focus.against >= SHARP
            else f"LESS SHARP than {beside}: check its focus, and whether somebody moved."
        )
    return sentences


def sum_words(facts: SumFacts, which: Sum, max_misfit: float) -> list[str]:
    """How well light adds up, in sentences.

    Args:
        facts: of the photographs.
        which: the patterns.
        max_misfit: the largest misfit that the session's checks allow, a share.
    """
    first, second, whole = which.patterns
    if facts.off is None or facts.misfit is None:
        sentences = [f"{first} and {second} against {whole}: too little is lit to compare them."]
    else:
        bad = facts.misfit > max_misfit
        sentences = [
            f"{'! ' if bad else ''}{first} and {second} together differ from {whole} by "
            f"{two_digits(100 * facts.off)} % on average, by {two_digits(100 * facts.misfit)} % "
            "after the best factor of each "
            f"(the checks allow {two_digits(100 * max_misfit)} % of that)."
        ]
    if facts.moved_px is None:
        sentences.append("Whether the subject moved between them is not known.")
    else:
        sentences.append(
            f"Between them the subject moved by up to {two_digits(facts.moved_px)} pixels "
            f"(standard error {two_digits(facts.error_px)})."
        )
    sentences.append(
        "Orange: brighter together; blue stripes: darker; full colour at 10 %. Thin edges in pairs "
        "are motion; a whole face in one colour is another light than was meant, or the room's."
    )
    return sentences


def _curves(histogram: Sequence[Sequence[float]]) -> list[tuple[str, str]]:
    """Name and points of each colour's line in an area of 256 x 100; heights are square roots."""
    top = max(max(map(max, histogram)), 1e-9)
    curves = []
    for name, shares in zip(("red", "green", "blue"), histogram, strict=True):
        points = [
            f"{256 * (i + 0.5) / BINS:.1f},{100 - 98 * (share / top) ** 0.5:.1f}"
            for i, share in enumerate(shares)
        ]
        curves.append((name, " ".join(points)))
    return curves


def device_values(state: JobState | None, facts: str, now_s: float) -> dict[str, Any]:
    """What the last check of the devices found, or why it failed, and when.

    Args:
        state: of the check; None where there was none.
        facts: the last line of its output.
        now_s: time.time().
    """
    if state is None:
        return {"state": None, "look": None, "findings": [], "problem": "", "when": ""}
    look: Any = None
    if not state.running and facts:
        try:
            look = parse_json(facts, "devices")
        except FormatError:
            look = None
    problem = "" if state.running else state.output
    if isinstance(look, dict) and isinstance(look.get("error"), dict):
        problem = text_of(look["error"], "message") or problem
    if not isinstance(look, dict) or "cameras" not in look:
        look = None
    findings = (
        [] if look is None else [notice_of({**f, "event": "finding"}) for f in look["findings"]]
    )
    when = when_words(state.ended_s, now_s) if state.ended_s else ""
    return {"state": state, "look": look, "findings": findings, "problem": problem, "when": when}


def when_words(then_s: float, now_s: float) -> str:
    """A past moment and how long ago it was, such as ``14:03 UTC, 12 min ago``."""
    then = datetime.datetime.fromtimestamp(then_s, datetime.UTC)
    minutes = max(0.0, now_s - then_s) / 60
    ago = f"{minutes / 60:.0f} h ago" if minutes >= 90 else f"{minutes:.0f} min ago"
    return f"{then:%H:%M} UTC, {'just now' if minutes < 1 else ago}"


def plan_facts(takes: Sequence[Planned]) -> str:
    """How much of the plan is done, as one sentence."""
    total = sum(each.take.wanted for each in takes)
    whole = [seen for each in takes for seen in each.sessions if seen.state == "whole"]
    faulty = sum(seen.accepted > 0 for seen in whole)
    with_faults = f", {faulty} of them with findings accepted" if faulty else ""
    return f"{len(whole)} of {counted(total, 'session')} done{with_faults}."
