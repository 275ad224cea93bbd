"""What the templates show: plain values, made of what stands in a session."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from lightstage.checks.config import ChecksConfig
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
from lightstage.operator.words import ANSWERS, KEYS, LEGEND, STATES, Mark, duration, merged, said

NEWS_SHOWN = 6
SHARP = 0.9
"""Fine detail against another photograph of the camera below which the page says so: a tenth less
is seen at once, and the checks' own limits decide what is taken again."""

MARKS: dict[Mark, str] = {
    "to come": "·",
    "now": "…",
    "kept": "✓",
    "failed": "X",
    "again": "r",
    "in question": "!",
    "accepted": "a",
}
"""Signs of photographs: read without any colour."""
MARK_WORDS: dict[Mark, str] = {**dict(LEGEND), "to come": "to come"}

BANNERS: dict[Phase, tuple[str, str]] = {
    "before": ("…", "NOT BEGUN"),
    "running": ("○", "DARK, at work"),
    "asked": ("?", "DARK, WAITING FOR YOU"),
    "paused": ("‖", "PAUSED, dark"),
    "aborted": ("■", "STOPPED, dark"),
    "complete": ("✓", "COMPLETE"),
    "gone": ("✕", "THE CAPTURE ENDED WITHOUT A WORD"),
}
"""Sign and words of each phase; of ``running`` where nothing is lit."""


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
    """A button and its key."""

    do: str
    key: str
    words: str


def desk_values(followed: Followed, state: JobState | None, most_rows: int) -> dict[str, Any]:
    """What the live view shows of a session.

    Args:
        followed: the session, looked at.
        state: the page's own job in it; None where there is none.
        most_rows: patterns at a time.
    """
    view = followed.view
    with view.lock:
        rows = _rows(followed, most_rows)
        sign, words = BANNERS[view.phase]
        if view.phase == "running" and view.pattern is not None:
            sign, words = "●", f"LIT: {view.pattern}"
        left = "" if view.over else duration(view.left_s())
        late = ""
        if view.late is not None:
            seconds = view.late.left_s()
            who = ", ".join(view.late.cameras)
            ends = "until the light goes out" if view.late.lit else "until it is started again"
            late = f"Waiting for {who}" + ("" if seconds is None else f": {seconds:.0f} s {ends}")
        return {
            "name": followed.root.name,
            "who": view.who,
            "phase": view.phase,
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
            "question": merged(view.question),
            # Plain lines stand in the list of what happened, below.
            "news": [n for n in reversed(merged(view.news)) if n.tone != "plain"][:NEWS_SHOWN],
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
            "actions": actions(view, followed.live),
            "live": followed.live,
            "job": state,
            "resumable": view.phase in ("aborted", "gone") and not followed.live,
            "marks": [(MARKS[mark], words) for mark, words in LEGEND],
            "last_id": view.last_id,
        }


def _rows(followed: Followed, most: int) -> list[Row]:
    """Patterns in order: all where they are few, else those that matter now."""
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


def actions(view: View, live: bool) -> list[Action]:
    """What can be asked for now, with the terminal's own keys."""
    if view.over:
        return []
    if not live:  # it has not told its socket yet: it can be stopped all the same
        return [Action("abort", *KEYS["abort"])]
    if view.phase == "asked":
        wanted: Sequence[str] = view.answers
        return [Action(do, KEYS[do][0], ANSWERS.get(do, KEYS[do][1])) for do in wanted]
    if view.phase == "paused":
        wanted = ("resume", "abort")
    else:
        wanted = ("retake", "pause", "abort") if view.done else ("pause", "abort")
    return [Action(do, *KEYS[do]) for do in wanted]


def look_values(facts: Facts) -> dict[str, Any]:
    """What stands beside a large picture."""
    clipped = [100 * share for share in facts.clipped]
    worst = max(clipped)
    sentences = [
        f"{facts.width_px} x {facts.height_px} pixels.",
        "Nothing is clipped."
        if worst == 0
        else f"Clipped (painted in stripes): red {two_digits(clipped[0])} %, green "
        f"{two_digits(clipped[1])} %, blue {two_digits(clipped[2])} % of the pixels looked at.",
        f"The brightest percent is at {two_digits(100 * facts.brightest)} % of white, the mean at "
        f"{two_digits(100 * facts.mean)} %.",
    ]
    return {"sentences": sentences, "curves": _curves(facts.histogram)}


def focus_words(focus: Focus, other: str) -> list[str]:
    """How sharp a photograph is, in sentences; `other` is the pattern that it was held against."""
    if focus.figure is None:
        return ["Focus: not known; the subject shows too little fine detail here."]
    figure = two_digits(focus.figure)
    sentences = [f"Focus figure {figure}: fine detail over coarse; higher is sharper."]
    if focus.against is not None:
        beside = f"this camera's photograph of {other} ({two_digits(focus.against)} of it)"
        sentences.append(
            f"As sharp as {beside}."
            if focus.against >= SHARP
            else f"LESS SHARP than {beside}: look at its focus, and whether somebody moved."
        )
    return sentences


def sum_words(facts: SumFacts, which: Sum) -> list[str]:
    """How well light adds up, in sentences."""
    limits = ChecksConfig()
    first, second, whole = which.patterns
    if facts.off is None or facts.misfit is None:
        sentences = [f"{first} and {second} against {whole}: too little is lit to tell."]
    else:
        bad = facts.misfit > limits.max_misfit_share
        sentences = [
            f"{'! ' if bad else ''}{first} and {second} together differ from {whole} by "
            f"{two_digits(100 * facts.off)} % on average, by {two_digits(100 * facts.misfit)} % "
            "after the best factor of each "
            f"(the checks bear {two_digits(100 * limits.max_misfit_share)} % of that)."
        ]
    if facts.moved_px is None:
        sentences.append("Whether the subject moved between them cannot be told here.")
    else:
        sentences.append(
            f"Between them the subject lies up to {two_digits(facts.moved_px)} pixels apart "
            f"(known to {two_digits(facts.error_px)})."
        )
    sentences.append(
        "Orange: brighter together; blue stripes: darker; full colour at 10 %. Thin edges in pairs "
        "are motion; a whole face in one colour is another light, or the room's."
    )
    return sentences


def _curves(histogram: Sequence[Sequence[float]]) -> list[tuple[str, str]]:
    """Name and points of each colour's line in a field of 256 x 100; heights are square roots."""
    top = max(max(map(max, histogram)), 1e-9)
    curves = []
    for name, shares in zip(("red", "green", "blue"), histogram, strict=True):
        points = [
            f"{256 * (i + 0.5) / BINS:.1f},{100 - 98 * (share / top) ** 0.5:.1f}"
            for i, share in enumerate(shares)
        ]
        curves.append((name, " ".join(points)))
    return curves


def device_values(state: JobState | None) -> dict[str, Any]:
    """What the last look at the devices found, or why it found nothing."""
    if state is None:
        return {"state": None, "look": None, "findings": []}
    look: Any = None
    if not state.running and state.said:
        try:
            look = parse_json(state.said.splitlines()[-1], "devices")
        except FormatError:
            look = None
    if not isinstance(look, dict) or "cameras" not in look:
        look = None
    findings = [] if look is None else [said({**f, "event": "finding"}) for f in look["findings"]]
    return {"state": state, "look": look, "findings": findings}


def plan_facts(takes: Sequence[Planned]) -> str:
    """How far the day is, as one sentence."""
    total = sum(each.take.wanted for each in takes)
    done = sum(seen.state == "whole" for each in takes for seen in each.sessions)
    return f"{done} of {counted(total, 'session')} done."
