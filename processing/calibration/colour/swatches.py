"""A picture of a chart as a camera reads it now, beside what it is."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.png import write_png
from processing.calibration.colour.chart import COLUMNS, ROWS
from processing.calibration.colour.fit import ColourFit
from processing.colour import srgb_from_linear

SIDE, GAP = 96, 8


def write_swatches(fit: ColourFit, known: np.ndarray, path: Path) -> Path:
    """Draw the 24 patches: as read, in each a square as it is, and the colour difference below.

    Args:
        fit: of a camera.
        known: (24, 3) reflectances.
        path: of a PNG.
    """
    pitch = SIDE + GAP
    picture = np.full((ROWS * pitch + GAP, COLUMNS * pitch + GAP, 3), 20, np.uint8)
    shown = np.rint(255 * srgb_from_linear(np.stack([fit.read, known]))).astype(np.uint8)
    for index in range(ROWS * COLUMNS):
        row, column = divmod(index, COLUMNS)
        top, left = GAP + row * pitch, GAP + column * pitch
        read, true = shown[:, index, ::-1]
        picture[top : top + SIDE, left : left + SIDE] = read
        inner = SIDE // 3
        picture[top + inner : top + 2 * inner, left + inner : left + 2 * inner] = true
        apart = fit.facts["patch_delta_e"][index]
        text = "" if apart is None else f"{apart:.2f}"
        if not fit.kept[index]:
            text += " left out"
        ink = (0, 0, 0) if known[index].mean() > 0.18 else (255, 255, 255)
        place = (left + 4, top + SIDE - 6)
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.38, ink, 1, cv2.LINE_AA)
    return write_png(path, picture[:, :, ::-1])
