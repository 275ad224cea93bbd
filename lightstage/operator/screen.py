"""The picture of a View in a terminal: devices, progress, news, keys; for 60 columns and more.

No colour carries a meaning alone, and no text is read as markup.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Sequence
from typing import Literal

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from lightstage.counting import counted
from lightstage.operator.cells import battery, card, sayable, short
from lightstage.operator.view import CameraView, State, View
from lightstage.operator.window import Scroll, fitting
from lightstage.operator.words import (
    ANSWERS,
    KEYS,
    LEGEND,
    QUESTION,
    SIGNS,
    STATES,
    Mark,
    Notice,
    Tone,
    duration,
    merged,
)

STYLES: dict[Tone, str] = {
    "quiet": "dim",
    "plain": "",
    "good": "green",
    "warning": "bold yellow",
    "problem": "bold red",
    "stop": "bold red",
}
MARKS: dict[Mark, tuple[str, str, str]] = {
    "to come": ("·", ".", "dim"),
    "now": ("▶", ">", "bold cyan"),
    "kept": ("✓", "+", "green"),
    "failed": ("✗", "X", "bold red"),
    "again": ("↻", "?", "bold yellow"),
    "in question": ("!", "!", "bold red"),
    "accepted": ("a", "a", "yellow"),
}
"""For a terminal with Unicode, for one without, and the style."""

NEEDY: tuple[State, ...] = ("failed", "in question", "late", "restarting")
"""States of cameras that need somebody."""
RARE: tuple[Mark, ...] = ("again", "in question", "accepted")
"""Marks that are explained where there are any."""
ROOMY = 100
"""Columns from which serial numbers are shown."""
LEGIBLE = 70
"""Columns from which the marks are explained."""
NOW_WIDE, POWER_WIDE, CARD_WIDE, SERIAL_WIDE = 14, 5, 6, 12


@dataclasses.dataclass(frozen=True)
class Ask:
    """What the operator can do now.

    Attributes:
        question: findings to decide on, in words; empty where nothing is asked.
        keys: requests that have a key now.
        heard: answer to the last key.
        scroll: by how many lines findings or news are scrolled.
        stopping_s: seconds since somebody stopped the capture; None where nobody did.
    """

    question: Sequence[Notice] = ()
    keys: Sequence[str] = ()
    heard: str = ""
    scroll: Scroll = dataclasses.field(default_factory=Scroll)
    stopping_s: float | None = None


@dataclasses.dataclass(frozen=True)
class Screen:
    """A renderable: the view at the moment when it is drawn."""

    view: View
    ask: Ask = dataclasses.field(default_factory=Ask)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        unicode = (options.encoding or "").lower().startswith("utf")
        width = options.max_width
        height = options.height or console.size.height
        with self.view.lock:
            keys = self._keys(width)
            below = [Text(QUESTION, "bold reverse"), *keys] if self.ask.question else keys
            # The head, the cameras that need somebody, and the keys are always in view.
            fixed = 4 + sum(_lines(console, options, part) for part in below)
            room = height - 1 - fixed - self._least_rows()
            share = height // (2 if self.ask.question else 3)
            news = self._news(console, options, max(2, min(share, room)))
            below = [*news, *below]
            used = 4 + sum(_lines(console, options, part) for part in below)
            # What need not be there goes first where the terminal is low.
            spare = height - 1 - used - len(self.view.cameras)
            words = self._legend(unicode)
            legend = [words] if spare >= 1 and LEGIBLE <= width >= words.cell_len else []
            gap = [Text()] if spare >= 2 else []
            rows = max(1, height - 1 - used - len(legend) - len(gap))
            middle = [
                self._progress(width, unicode),
                *gap,
                self._cameras(width, rows, unicode),
                *legend,
            ]
            begun = middle if self.view.cameras else []
            whole = Group(self._title(width), self._lights(), *begun, *below)
            for segment in console.render(whole, options):
                yield segment._replace(text=sayable(segment.text, options.encoding))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(40, options.max_width)

    def _title(self, width: int) -> RenderableType:
        where = Text(self.view.session, style="dim", overflow="ellipsis", no_wrap=True)
        who = Text(self.view.who or "LIGHT STAGE", style="bold", no_wrap=True)
        if who.cell_len + where.cell_len + 3 > width:
            return who
        return _sides(who, where)

    def _lights(self) -> RenderableType:
        view = self.view
        line = Text(overflow="ellipsis", no_wrap=True)
        if view.phase == "gone":
            line.append("NO CAPTURE RUNS", "bold red")
            return line
        if self.ask.stopping_s is not None and not view.over:
            line.append(f"STOPPING for {self.ask.stopping_s:.0f} s", "bold red")
        elif view.phase == "before":
            line.append("Lights and cameras are being checked.", "bold")
            return line
        elif view.phase == "running" and view.pattern:
            line.append("DARK" if view.unlit else f"TAKING {view.pattern}", "bold")
            self._countdown(line)
        else:
            line.append("DARK", "bold")
            why = {"asked": ", waiting for you", "paused": " (paused)", "aborted": " (stopped)"}
            line.append(why.get(view.phase, ""), "bold")
        if view.acknowledged is not None:
            sure = "acknowledged" if view.acknowledged else "! NOT acknowledged"
            line.append(f", {sure}", "" if view.acknowledged else "bold yellow")
        if view.lights:
            line.append(f"   {view.lights}", "dim")
        return line

    def _countdown(self, line: Text) -> None:
        """Cameras that the others wait for, and the seconds until something is done about it."""
        late = self.view.late
        if late is None:
            return
        left_s = late.left_s()
        soon = "soon" if left_s is None else f"in {left_s:.0f} s"
        who = short(", ".join(late.cameras), 24)
        left = (
            f"{who} late: dark {soon}" if late.lit else f"waiting for {who}: started again {soon}"
        )
        line.append(f", {left}", "bold yellow")

    def _least_rows(self) -> int:
        """Lines of the table that must be in view: what needs somebody, and how many more."""
        needy = sum(map(self._is_needy, self.view.cameras))
        return min(len(self.view.cameras), 1 + min(3, max(1, needy)))

    def _is_needy(self, name: str) -> bool:
        """Whether a camera failed, or the question is about it."""
        is_in_question = any(item.camera == name for item in self.ask.question)
        return is_in_question or self.view.cameras[name].state in NEEDY

    def _progress(self, width: int, unicode: bool) -> RenderableType:
        view = self.view
        kept, wanted = view.kept, max(view.wanted, 1)
        full, empty = ("█", "░") if unicode else ("#", "-")
        cells = max(8, min(40, width - 46))
        filled = cells * min(kept, wanted) // wanted
        line = Text(no_wrap=True, overflow="ellipsis")
        line.append(full * filled, "" if view.phase in ("aborted", "gone") else "green")
        line.append(empty * (cells - filled), "dim")
        line.append(f" {kept} of {counted(view.wanted, 'photograph')}", "bold")
        if view.phase == "complete":
            line.append(", COMPLETE", "bold green")
        elif view.phase == "aborted":
            line.append(", STOPPED", "bold red")
        elif view.phase not in ("before", "gone"):
            line.append(f", {duration(view.left_s())}")
        return line

    def _cameras(self, width: int, rows: int, unicode: bool) -> RenderableType:
        view = self.view
        table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, show_edge=False)
        roomy = width >= ROOMY
        names = {name: short(name, 24 if roomy else 10) for name in view.cameras}
        name_wide = max(6, *map(len, names.values())) if names else 6
        columns = [("Camera", name_wide, True), ("Now", NOW_WIDE, True)]
        columns += [("Power", POWER_WIDE, False), ("Card", CARD_WIDE, False)]
        serials = [len(camera.serial) for camera in view.cameras.values()]
        serial_wide = min(SERIAL_WIDE, max(6, *serials)) if serials else 6
        columns += [("Serial", serial_wide, False)] if roomy else []
        for title, wide, left in columns:
            side: Literal["left", "right"] = "left" if left else "right"
            table.add_column(title, width=wide, no_wrap=True, justify=side, header_style="dim")
        room = width - sum(wide + 2 for _, wide, _ in columns)
        shown, wide = self._window(room)
        table.add_column(self._header(shown, wide, room), no_wrap=True, header_style="dim")
        order = self._rows(rows)
        for name in order:
            camera = view.cameras[name]
            cells = [Text(names[name]), self._state(camera), battery(camera), card(camera)]
            cells += [Text(short(camera.serial, SERIAL_WIDE) or "-", "dim")] if roomy else []
            table.add_row(*cells, self._marks(name, shown, wide, unicode))
        hidden = [camera for name, camera in view.cameras.items() if name not in order]
        if not hidden:
            return table
        states = collections.Counter(camera.state for camera in hidden)
        needy = "".join(f", {states[each]} {STATES[each]}" for each in NEEDY if states[each])
        more = Text(f"+{len(hidden)} more cameras", "dim", no_wrap=True, overflow="ellipsis")
        return Group(table, more.append(needy, "bold red"))

    def _rows(self, rows: int) -> list[str]:
        """Cameras to show where not all fit: those that failed or work come first."""
        names = list(self.view.cameras)
        if len(names) <= rows:
            return names
        busy = (*NEEDY, "triggering", "downloading", "kept", "idle")

        def need(name: str) -> tuple[bool, int]:
            return not self._is_needy(name), busy.index(self.view.cameras[name].state)

        by_need = sorted(names, key=need)
        chosen = set(by_need[: max(1, rows - 1)])
        return [name for name in names if name in chosen]

    def _window(self, room: int) -> tuple[list[str], int]:
        """Patterns to show and how wide each; around the present one where not all fit."""
        patterns = self.view.patterns
        wide = max(map(len, patterns), default=1) + 1
        if len(patterns) * wide <= room:
            return patterns, wide
        fit = max(4, room)
        if len(patterns) <= fit:
            return patterns, 1
        at = next((i for i, name in enumerate(patterns) if name not in self.view.done), 0)
        first = min(max(0, at - fit // 2), len(patterns) - fit)
        return patterns[first : first + fit], 1

    def _header(self, shown: Sequence[str], wide: int, room: int) -> Text:
        if wide > 1:
            return Text("".join(name.ljust(wide) for name in shown))
        patterns, done = self.view.patterns, self.view.done
        first = patterns.index(shown[0]) + 1 if shown else 0
        at = sum(name in done for name in patterns)
        count = len(patterns)
        part = f"{first}-{first + len(shown) - 1} of {count}"
        texts = [f"patterns {part}", part]
        if len(shown) == count:  # all are in view
            texts = [f"{counted(count, 'pattern')}, {at} done", f"{at} of {count} done"]
        fitting_texts = [text for text in texts if len(text) <= max(room, len(shown))]
        return Text(fitting_texts[0] if fitting_texts else "")

    def _marks(self, camera: str, shown: Sequence[str], wide: int, unicode: bool) -> Text:
        line = Text()
        for pattern in shown:
            mark = self.view.mark(pattern, camera)
            sign, plain, style = MARKS[mark]
            take = self.view.takes.get((pattern, camera), 1)
            if mark == "kept" and take > 1:
                sign = plain = str(take) if take < 10 else "9"
            line.append((sign if unicode else plain).ljust(wide), style)
        return line

    def _state(self, camera: CameraView) -> Text:
        if self.view.over and camera.state != "failed":
            return Text("-", "dim")
        style = dict.fromkeys(NEEDY, "bold yellow") | {"kept": "green"}
        style |= dict.fromkeys(("failed", "in question"), "bold red")
        return Text(STATES[camera.state], style.get(camera.state, ""))

    def _legend(self, unicode: bool) -> Text:
        """The signs of the table in words; the rare ones where there are any."""
        line = Text(style="dim")
        marks = {mark for of in self.view.marks.values() for mark in of.values()}
        for mark, words in LEGEND:
            if mark in RARE and mark not in marks:
                continue
            sign, plain, style = MARKS[mark]
            line.append(sign if unicode else plain, style)
            line.append(f" {words}  ")
        if self.view.takes:
            line.append("2..9 which take")
        line.rstrip()
        return line

    def _news(self, console: Console, options: ConsoleOptions, room: int) -> list[RenderableType]:
        """The question, or the latest news, as far as there is room for it."""
        question = self.ask.question
        items = [_item(item) for item in merged(question if question else self.view.news)]
        gap: list[RenderableType] = [Text()] if room > 4 else []
        room -= len(gap)
        scroll, keys = self.ask.scroll, not self.view.over
        shown = fitting(items, room, scroll, console, options, not question, keys)
        return [*gap, *shown]

    def _keys(self, width: int) -> list[RenderableType]:
        lines: list[RenderableType] = []
        if self.ask.heard:
            lines.append(Text(f"> {self.ask.heard}", "bold"))
        if self.ask.keys:
            line = Text()
            for request in self.ask.keys:
                key, words = KEYS[request]
                words = ANSWERS.get(request, words) if self.ask.question else words
                # A key and its words stay together: what does not fit begins a line of its own.
                if line and line.cell_len + len(f" {key}  {words}") > width:
                    lines.append(line)
                    line = Text()
                line.append(f" {key} ", "reverse bold")
                line.append(f" {words}  ")
            line.rstrip()
            lines.append(line)
        return lines


def _item(item: Notice) -> RenderableType:
    line = Table.grid(padding=(0, 1, 0, 0))
    text = item.text if item.text.endswith((".", "!", "?")) else f"{item.text}."
    line.add_row(Text(SIGNS[item.tone], STYLES[item.tone]), Text(text, STYLES[item.tone]))
    if item.todo:
        line.add_row(Text(), Text(item.todo, "bold"))
    return line


def _sides(left: Text, right: Text) -> Table:
    table = Table.grid(expand=True)
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_row(left, right)
    return table


def _lines(console: Console, options: ConsoleOptions, part: RenderableType) -> int:
    return len(console.render_lines(part, options.update(height=None), pad=False))
