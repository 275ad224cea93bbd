"""A part of many lines that fits, and can be scrolled by keys."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.segment import Segment
from rich.text import Text

from lightstage.counting import counted


@dataclasses.dataclass
class Scroll:
    """How many lines somebody scrolled; negative is back. Drawing sets it to what is possible."""

    at: int = 0


@dataclasses.dataclass(frozen=True)
class Window:
    """A renderable: lines that were rendered already."""

    lines: Sequence[Sequence[Segment]]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for line in self.lines:
            yield from line
            yield Segment.line()


def fitting(
    items: Sequence[RenderableType],
    room: int,
    scroll: Scroll,
    console: Console,
    options: ConsoleOptions,
    latest: bool,
    keys: bool = True,
) -> list[RenderableType]:
    """As much of these items as fits into `room` lines, and how to see the rest.

    Args:
        items: one below the other.
        room: lines that there are.
        scroll: where to; from the first item on, or back from the last one.
        console: to measure them with.
        options: with its width.
        latest: whether the last item matters most; else the first.
        keys: whether somebody can scroll.
    """
    blocks = [console.render_lines(i, options.update(height=None), pad=False) for i in items]
    lines = [line for block in blocks for line in block]
    if len(lines) <= room:
        scroll.at = 0
        return [Window(lines)] if lines else []
    room = max(1, room - 1)
    last = len(lines) - room
    if latest:
        scroll.at = max(-last, min(0, scroll.at))
        begins = [sum(map(len, blocks[:i])) for i in range(len(blocks))]
        # Begin with a whole item; one that is longer than the room shows how it begins.
        start = next((at for at in begins if at >= last), begins[-1])
        start = max(0, start + scroll.at)
    else:
        scroll.at = start = max(0, min(last, scroll.at))
    shown = lines[start : start + room]
    below = len(lines) - start - len(shown)
    parts = [f"{counted(start, 'more line')} above"] if start else []
    parts += [f"{counted(below, 'more line')} below"] if below else []
    how = ": arrow keys" if keys else ""
    return [Window(shown), Text(f"  {', '.join(parts)}{how}", "dim")]
