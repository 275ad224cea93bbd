"""Line plots as PNG, drawn with OpenCV."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.files import atomic_path

WIDTH, HEIGHT = 380, 280
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 34, 46
INK, GRID, PAPER = (40, 40, 40), (225, 225, 225), (255, 255, 255)
COLOURS = ((180, 105, 30), (60, 60, 200), (60, 140, 40), (150, 60, 150), (30, 140, 220))
"""Of the lines in turn, BGR."""
FACE = cv2.FONT_HERSHEY_SIMPLEX


@dataclasses.dataclass(frozen=True)
class Line:
    """One line: its name, (k,) places and values, whether it is drawn dashed, its colour's index.

    Values that are not finite leave a gap.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    dashed: bool = False


@dataclasses.dataclass(frozen=True)
class Panel:
    """One plot: title, name of the x axis, lines; y starts at 0 unless `log`."""

    title: str
    across: str
    lines: Sequence[Line]
    log_x: bool = False
    log_y: bool = False


def draw(panels: Sequence[Sequence[Panel]], path: Path) -> Path:
    """Draw rows of panels with one legend below, and write the picture.

    Args:
        panels: rows of the same length.
        path: PNG.
    """
    rows = [np.concatenate([_panel(panel) for panel in row], axis=1) for row in panels]
    picture = np.concatenate([*rows, _legend(panels, rows[0].shape[1])], axis=0)
    with atomic_path(path) as beside:
        ok, data = cv2.imencode(".png", picture)
        if not ok:
            raise OSError(f"{path}: cannot be encoded")
        beside.write_bytes(data.tobytes())
    return path


def ticks(low: float, high: float, log: bool) -> list[float]:
    """Round values inside a range: a decade's 1, 2 and 5 when `log`, else four to eight steps."""
    if log:
        first, last = int(np.floor(np.log10(low))), int(np.ceil(np.log10(high)))
        many = [m * 10.0**e for e in range(first, last + 1) for m in (1, 2, 5)]
        inside = [v for v in many if low * 0.999 <= v <= high * 1.001]
        return inside if len(inside) <= 7 else [v for v in inside if f"{v:e}"[0] == "1"]
    step = 10 ** np.floor(np.log10(max(high - low, 1e-12)))
    for share in (0.2, 0.5, 1.0):
        if (high - low) / (share * step) <= 6:
            step *= share
            break
    return [float(v) + 0.0 for v in np.arange(np.ceil(low / step), high / step + 1e-9) * step]


def _panel(panel: Panel) -> np.ndarray:
    image = np.full((HEIGHT, WIDTH, 3), PAPER, np.uint8)
    _write(image, panel.title, (LEFT, 22), 0.46)
    x = np.concatenate([np.asarray(line.x, float) for line in panel.lines])
    y = np.concatenate([np.asarray(line.y, float) for line in panel.lines])
    good = np.isfinite(x) & np.isfinite(y) & ((x > 0) | (not panel.log_x))
    good &= (y > 0) | (not panel.log_y)
    if not good.any():
        return image
    low_x, high_x = _span(x[good], panel.log_x, from_zero=False)
    low_y, high_y = _span(y[good], panel.log_y, from_zero=True)

    def place(values: np.ndarray, low: float, high: float, log: bool) -> np.ndarray:
        if log:
            values, low, high = np.log(values), np.log(low), np.log(high)
        return (values - low) / max(high - low, 1e-12)

    def across(values: np.ndarray) -> np.ndarray:
        return LEFT + place(values, low_x, high_x, panel.log_x) * (WIDTH - LEFT - RIGHT)

    def up(values: np.ndarray) -> np.ndarray:
        inside = HEIGHT - TOP - BOTTOM
        return HEIGHT - BOTTOM - place(values, low_y, high_y, panel.log_y) * inside

    for value in ticks(low_y, high_y, panel.log_y):
        row = round(float(up(np.array(value))))
        cv2.line(image, (LEFT, row), (WIDTH - RIGHT, row), GRID, 1)
        label = f"{value:g}"
        _write(image, label, (LEFT - 6 - _width(label, 0.36), row + 4), 0.36)
    for value in ticks(low_x, high_x, panel.log_x):
        column = round(float(across(np.array(value))))
        cv2.line(image, (column, TOP), (column, HEIGHT - BOTTOM), GRID, 1)
        label = f"{value:g}"
        _write(image, label, (column - _width(label, 0.36) // 2, HEIGHT - BOTTOM + 15), 0.36)
    cv2.rectangle(image, (LEFT, TOP), (WIDTH - RIGHT, HEIGHT - BOTTOM), INK, 1)
    middle = (LEFT + WIDTH - RIGHT - _width(panel.across, 0.4)) // 2
    _write(image, panel.across, (middle, HEIGHT - 12), 0.4)
    for line in panel.lines:
        xs, ys = np.asarray(line.x, float), np.asarray(line.y, float)
        shown = np.isfinite(xs) & np.isfinite(ys)
        shown &= ((xs > 0) | (not panel.log_x)) & ((ys > 0) | (not panel.log_y))
        points = np.stack([across(xs[shown]), up(ys[shown])], axis=1)
        _polyline(image, points, line)
    return image


def _span(values: np.ndarray, log: bool, *, from_zero: bool) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    if log:
        return (low / 1.2, high * 1.2)
    if from_zero:
        return 0.0, high * 1.08 or 1.0
    margin = 0.04 * (high - low) or 0.5
    return low - margin, high + margin


def _polyline(image: np.ndarray, points: np.ndarray, line: Line) -> None:
    colour = COLOURS[line.colour % len(COLOURS)]
    for a, b in itertools.pairwise(points):
        pieces = max(1, int(np.linalg.norm(b - a) / 5)) if line.dashed else 1
        for k in range(0, pieces, 2):
            ends = [a + (b - a) * share / pieces for share in (k, min(k + 1, pieces))]
            (x0, y0), (x1, y1) = (end.round().astype(int).tolist() for end in ends)
            cv2.line(image, (x0, y0), (x1, y1), colour, 2, cv2.LINE_AA)
    for x, y in points.round().astype(int).tolist():
        cv2.circle(image, (x, y), 3, colour, -1, cv2.LINE_AA)


def _legend(panels: Sequence[Sequence[Panel]], width: int) -> np.ndarray:
    named: dict[str, Line] = {}
    for row in panels:
        for panel in row:
            for line in panel.lines:
                named.setdefault(line.name, line)
    places, x, y = [], 16, 18
    for name in named:
        wide = 44 + _width(name, 0.42) + 24
        if x + wide > width and x > 16:
            x, y = 16, y + 24
        places.append((x, y))
        x += wide
    image = np.full((y + 18, width, 3), PAPER, np.uint8)
    for (x, y), line in zip(places, named.values(), strict=True):
        ends = np.array([[x, y], [x + 34, y]], float)
        _polyline(image, ends, line)
        _write(image, line.name, (x + 44, y + 4), 0.42)
    return image


def _width(text: str, size: float) -> int:
    return int(cv2.getTextSize(text, FACE, size, 1)[0][0])


def _write(image: np.ndarray, text: str, place: tuple[int, int], size: float) -> None:
    cv2.putText(image, text, place, FACE, size, INK, 1, cv2.LINE_AA)
