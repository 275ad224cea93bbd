"""A plot as SVG: a column for each setting, a dot for each seed, the mean and its interval."""

from __future__ import annotations

import dataclasses
import html
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from learning.bootstrap import Interval
from lightstage.formats.files import write_text

WIDTH, HEIGHT = 760, 360
LEFT, RIGHT, TOP, BOTTOM = 70, 20, 40, 96
INK, DOT, MEAN, GRID = "#222", "#7aa6d6", "#b03a2e", "#ddd"
LETTERS = 16
"""Letters of a column's name, at most, before it is cut into lines."""


@dataclasses.dataclass(frozen=True)
class Column:
    """One setting: its name, each seed's mean over people, and the whole with its interval."""

    name: str
    seeds: Sequence[float]
    whole: Interval


def draw(title: str, across: str, up: str, columns: Sequence[Column], path: Path) -> Path:
    """Write a plot whose axis begins at 0.

    Args:
        title: above it.
        across: name of the settings' axis; may be empty.
        up: name of the figures' axis.
        columns: in order.
        path: file, .svg.
    """
    values = [v for c in columns for v in (*c.seeds, c.whole.mean, c.whole.high)]
    top = 1.08 * max((v for v in values if math.isfinite(v)), default=1.0) or 1.0
    inside = HEIGHT - TOP - BOTTOM

    def height(value: float) -> float:
        return HEIGHT - BOTTOM - inside * value / top

    parts = [_text(LEFT, 22, title, size=15, anchor="start")]
    for value in _ticks(top):
        row = height(value)
        parts.append(_line(LEFT, row, WIDTH - RIGHT, row, GRID))
        parts.append(_text(LEFT - 6, row + 4, f"{value:.3g}", anchor="end"))
    each = (WIDTH - LEFT - RIGHT) / max(1, len(columns))
    for index, column in enumerate(columns):
        x = LEFT + (index + 0.5) * each
        for seed in column.seeds:
            if math.isfinite(seed):
                parts.append(
                    f'<circle cx="{x + 8:.1f}" cy="{height(seed):.1f}" r="3" fill="{DOT}"/>'
                )
        whole = column.whole
        if math.isfinite(whole.low):
            parts.append(_line(x - 6, height(whole.low), x - 6, height(whole.high), MEAN, 2))
        if math.isfinite(whole.mean):
            row = height(whole.mean)
            parts.append(_line(x - 14, row, x + 2, row, MEAN, 3))
        for number, words in enumerate(_cut(column.name)):
            parts.append(_text(x, HEIGHT - BOTTOM + 18 + 14 * number, words))
    parts.append(_line(LEFT, HEIGHT - BOTTOM, WIDTH - RIGHT, HEIGHT - BOTTOM, INK))
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, across))
    parts.append(
        f'<text x="16" y="{TOP + inside / 2:.0f}" font-size="12" fill="{INK}" '
        f'text-anchor="middle" transform="rotate(-90 16 {TOP + inside / 2:.0f})">'
        f"{html.escape(up)}</text>"
    )
    body = "\n".join(parts)
    return write_text(
        path,
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="sans-serif">\n<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>\n'
        f"{body}\n</svg>\n",
    )


def _ticks(top: float) -> list[float]:
    step = 10 ** math.floor(math.log10(top))
    step *= next(share for share in (0.2, 0.5, 1.0) if top / (share * step) <= 6 or share == 1.0)
    return [float(value) for value in np.arange(0, top + 1e-12, step)]


def _cut(name: str) -> list[str]:
    """A name in lines of about `LETTERS`."""
    lines = [""]
    for word in name.replace("`", "").split():
        if lines[-1] and len(lines[-1]) + len(word) >= LETTERS:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _text(x: float, y: float, words: str, size: int = 12, anchor: str = "middle") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{INK}" '
        f'text-anchor="{anchor}">{html.escape(words)}</text>'
    )


def _line(x0: float, y0: float, x1: float, y1: float, colour: str, width: int = 1) -> str:
    return (
        f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{colour}" '
        f'stroke-width="{width}"/>'
    )
