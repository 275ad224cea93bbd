"""A sheet of pictures to look at: by head and light the texture, what was found, and the truth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.png import write_png
from processing.colour import srgb_from_linear

ROWS = 240
"""Of one texture."""
LABEL_PX = 16
MOST_HEADS = 10


def tile(image: np.ndarray) -> np.ndarray:
    """(ROWS, ROWS * 2 / 3, 3) uint8 of a linear texture."""
    small = cv2.resize(
        image.astype(np.float32), (ROWS * 2 // 3, ROWS), interpolation=cv2.INTER_AREA
    )
    return np.round(255 * srgb_from_linear(np.clip(small, 0, 1))).astype(np.uint8)


def strip(images: list[np.ndarray], label: str) -> np.ndarray:
    """Textures side by side under a label, uint8."""
    row = np.concatenate([tile(image) for image in images], axis=1)
    head = np.zeros((LABEL_PX, row.shape[1], 3), np.uint8)
    cv2.putText(head, label, (3, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1)
    return np.concatenate([head, row])


def write_sheet(strips: dict[tuple[str, str], np.ndarray], path: Path) -> Path:
    """Write a sheet: a column for each head, a row for each light.

    Args:
        strips: of `strip`, by head and light, all of one size.
        path: the first `MOST_HEADS` heads, .png.
    """
    heads = list(dict.fromkeys(head for head, _ in strips))[:MOST_HEADS]
    lights = list(dict.fromkeys(light for _, light in strips))
    blank = np.zeros_like(next(iter(strips.values())))
    rows = [
        np.concatenate([strips.get((head, light), blank) for head in heads], axis=1)
        for light in lights
    ]
    return write_png(path, np.concatenate(rows))
