"""Numbered points in panels as PNG, drawn with OpenCV: run time across, error up."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.files import atomic_path

WIDTH, HEIGHT = 420, 320
LEFT, RIGHT, TOP, BOTTOM = 60, 20, 34, 44
INK, GRID, POINT = (40, 40, 40), (225, 225, 225), (180, 105, 30)
FACE = cv2.FONT_HERSHEY_SIMPLEX
LINE_PX = 20


@dataclasses.dataclass(frozen=True)
class Panel:
    """One plot: its title and (x, y) of every name's point; x is drawn by its logarithm."""

    title: str
    points: Sequence[tuple[float, float]]


def draw(
    panels: Sequence[Panel], names: Sequence[str], across: str, path: Path, columns: int
) -> Path:
    """Draw panels in rows, the names with their numbers below, and write the picture."""
    images = [_panel(panel, across) for panel in panels]
    rows = [np.concatenate(images[k : k + columns], axis=1) for k in range(0, len(images), columns)]
    width = rows[0].shape[1]
    per_row = max(1, width // 300)
    legend = np.full((LINE_PX * (-(-len(names) // per_row) + 1), width, 3), 255, np.uint8)
    for k, name in enumerate(names):
        place = (LEFT + (k % per_row) * 300, LINE_PX * (k // per_row + 1))
        _write(legend, f"{k + 1}  {name}", place, 0.42)
    with atomic_path(path) as beside:
        done, data = cv2.imencode(".png", np.concatenate([*rows, legend], axis=0))
        if not done:
            raise OSError(f"{path}: cannot be encoded")
        beside.write_bytes(data.tobytes())
    return path


def _panel(panel: Panel, across: str) -> np.ndarray:
    image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    x, y = np.log10(np.array([p[0] for p in panel.points])), np.array([p[1] for p in panel.points])
    low, high, top = x.min() - 0.15, x.max() + 0.15, y.max() * 1.1
    to_x = LEFT + (x - low) / (high - low) * (WIDTH - LEFT - RIGHT)
    to_y = HEIGHT - BOTTOM - y / top * (HEIGHT - TOP - BOTTOM)
    for power in range(int(np.ceil(low)), int(np.floor(high)) + 1):
        column = int(LEFT + (power - low) / (high - low) * (WIDTH - LEFT - RIGHT))
        cv2.line(image, (column, TOP), (column, HEIGHT - BOTTOM), GRID, 1)
        _write(image, f"{10.0**power:g}", (column - 8, HEIGHT - BOTTOM + 15), 0.36)
    for share in (0, 0.25, 0.5, 0.75, 1):
        row = int(HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM))
        cv2.line(image, (LEFT, row), (WIDTH - RIGHT, row), GRID, 1)
        _write(image, f"{share * top:.3g}", (8, row + 4), 0.36)
    _write(image, panel.title, (LEFT, 22), 0.46)
    _write(image, across, (LEFT + 60, HEIGHT - 10), 0.4)
    for k, (a, b) in enumerate(zip(to_x, to_y, strict=True)):
        cv2.circle(image, (int(a), int(b)), 3, POINT, -1, cv2.LINE_AA)
        _write(image, str(k + 1), (int(a) + 5, int(b) - 4), 0.38)
    return image


def _write(image: np.ndarray, text: str, place: tuple[int, int], size: float) -> None:
    cv2.putText(image, text, place, FACE, size, INK, 1, cv2.LINE_AA)
