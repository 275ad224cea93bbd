"""One pass over a mosaic: light, clipping and fine detail in square cells."""

from __future__ import annotations

import numba
import numpy as np

FAR = 3
"""Step of the longer second difference, in quads; the shorter one's is a quad."""
REACH = 2 * FAR


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cells_kernel(
    counts: np.ndarray,
    colours: np.ndarray,
    black: np.ndarray,
    white: float,
    quads: int,
    light: np.ndarray,
    detail: np.ndarray,
    clipped: np.ndarray,
    extremes: np.ndarray,
) -> None:
    """Sum a mosaic into cells of `quads` x `quads` quads of 2 x 2 pixels.

    Args:
        counts: (h, w) of any real type; what is not finite counts as black and is counted.
        colours: (2, 2) int64, colour 0, 1 or 2 of each place in a quad.
        black: (2, 2) float64 counts without light, by place.
        white: counts from which a pixel is clipped.
        quads: side of a cell.
        light: (rows, columns, 3) float64, overwritten: mean above black of each colour.
        detail: (rows, columns, 3) float64, overwritten: variance of a green pixel from the
            difference of a quad's two greens; mean squared second difference of greens (a quad's
            mean) at steps of one quad and of `FAR` quads, along rows and columns.
        clipped: (rows, columns, 3) int64, overwritten: clipped pixels of each colour.
        extremes: (4,) float64, overwritten: least and greatest count, how many pixels have the
            greatest, how many are not finite.
    """
    rows, columns = light.shape[0], light.shape[1]
    least, greatest, pile, wild = np.inf, -np.inf, 0, 0
    number = np.zeros(3)
    for y in range(2):
        for x in range(2):
            number[colours[y, x]] += quads * quads
    green = np.zeros((quads + REACH, columns * quads + REACH))
    all_rows, all_columns = counts.shape[0] // 2, counts.shape[1] // 2
    for row in range(rows):
        light[row] = 0.0
        detail[row] = 0.0
        clipped[row] = 0
        wide = min(columns * quads + REACH, all_columns)
        high = min(quads + REACH, all_rows - row * quads)
        for j in range(high):
            own = j < quads
            y0 = 2 * (row * quads + j)
            for i in range(wide):
                cell = i // quads
                inside = own and cell < columns
                total, squared, greens = 0.0, 0.0, 0
                for y in range(2):
                    for x in range(2):
                        value = float(counts[y0 + y, 2 * i + x])
                        colour = colours[y, x]
                        if not np.isfinite(value):
                            if inside:
                                wild += 1
                            value = black[y, x]
                        above = value - black[y, x]
                        if colour == 1:
                            total += above
                            squared = above - squared
                            greens += 1
                        if inside:
                            light[row, cell, colour] += above
                            if value >= white:
                                clipped[row, cell, colour] += 1
                            if value < least:
                                least = value
                            if value > greatest:
                                greatest, pile = value, 1
                            elif value == greatest:
                                pile += 1
                green[j, i] = total / max(greens, 1)
                if inside and greens == 2:
                    detail[row, cell, 0] += 0.5 * squared * squared
        for j in range(min(quads, high)):
            for i in range(columns * quads):
                here = green[j, i]
                cell = i // quads
                if i + REACH < wide and j + REACH < high:
                    near_x = here - 2.0 * green[j, i + 1] + green[j, i + 2]
                    near_y = here - 2.0 * green[j + 1, i] + green[j + 2, i]
                    far_x = here - 2.0 * green[j, i + FAR] + green[j, i + REACH]
                    far_y = here - 2.0 * green[j + FAR, i] + green[j + REACH, i]
                    detail[row, cell, 1] += 0.5 * (near_x * near_x + near_y * near_y)
                    detail[row, cell, 2] += 0.5 * (far_x * far_x + far_y * far_y)
        for cell in range(columns):
            for colour in range(3):
                if number[colour] > 0:
                    light[row, cell, colour] /= number[colour]
                detail[row, cell, colour] /= quads * quads
    extremes[0], extremes[1], extremes[2], extremes[3] = least, greatest, pile, wild
