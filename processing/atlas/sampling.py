"""Reading a picture at texels: sharply for detail, from a small blurred copy for the low band."""

from __future__ import annotations

import dataclasses

import cv2
import numba
import numpy as np

LEAST_COVER = 0.25
"""A texel whose bilinear neighbourhood holds less usable share than this is not read."""
SHARPNESS = -0.7
"""The cubic's free number. Averaged over places between pixels, -0.5 takes 27 % of the energy from
waves three pixels long and 8 % from those of four and a half; -0.7 takes 22 and 1 %, and gives at
most 2 % to longer ones."""


@dataclasses.dataclass(frozen=True)
class LowBand:
    """A picture's masked Gaussian blur, on a grid as coarse as the blur allows.

    Attributes:
        sums: (h, w, c) float32, blurred values of usable pixels.
        counts: (h, w) float32, the same of ones.
        step: pixels of the picture per cell of the grid.
    """

    sums: np.ndarray
    counts: np.ndarray
    step: int


def low_band(image: np.ndarray, usable: np.ndarray, sigma_px: float) -> LowBand:
    """Blur the usable part alone.

    Blurred pictures need few samples: at full size a kernel of 3 mm has hundreds of taps.

    Args:
        image: (h, w, c) float32, anything outside `usable`.
        usable: (h, w) bool.
        sigma_px: of the Gaussian.

    Returns:
        LowBand; its blur's variance is that asked for, the cells' own included.
    """
    step = max(1, int(sigma_px / 3))
    height, width, channels = image.shape
    shape = (-(-height // step), -(-width // step))
    sums = np.zeros((*shape, channels), np.float32)
    counts = np.zeros(shape, np.float32)
    _decimate(np.ascontiguousarray(image, np.float32), usable, step, sums, counts)
    sigma = np.sqrt(max(sigma_px**2 - (step**2 - 1) / 12, 0.01)) / step
    size = 2 * int(np.ceil(3.5 * sigma)) + 1
    for array in (*np.moveaxis(sums, 2, 0), counts):
        plain = np.ascontiguousarray(array)
        array[:] = cv2.GaussianBlur(plain, (size, size), sigma, borderType=cv2.BORDER_CONSTANT)
    return LowBand(sums, counts, step)


@numba.njit(cache=True, parallel=True)
def _decimate(
    image: np.ndarray, usable: np.ndarray, step: int, sums: np.ndarray, counts: np.ndarray
) -> None:
    """Means over cells (sums and counts of usable pixels over the cell's area)."""
    height, width, channels = image.shape
    area = 1.0 / (step * step)
    for row in numba.prange(counts.shape[0]):
        for y in range(row * step, min((row + 1) * step, height)):
            for x in range(width):
                if usable[y, x]:
                    column = x // step
                    counts[row, column] += area
                    for c in range(channels):
                        sums[row, column, c] += area * image[y, x, c]


@numba.njit(cache=True, inline="always")
def _cubic(t: float, k: int) -> float:
    """Weight of tap k of four under Keys's cubic convolution [Keys1981], t past the second."""
    x = abs(t + 1 - k)
    if x < 1:
        return 1.0 + x * x * ((SHARPNESS + 2.0) * x - (SHARPNESS + 3.0))
    return SHARPNESS * (x * (x * (x - 5.0) + 8.0) - 4.0)


@numba.njit(cache=True, parallel=True)
def accumulate(
    image: np.ndarray,
    usable: np.ndarray,
    low_sums: np.ndarray,
    low_counts: np.ndarray,
    low_step: int,
    slot: np.ndarray,
    pixel: np.ndarray,
    weight: np.ndarray,
    power: float,
    sum_low: np.ndarray,
    sum_fine: np.ndarray,
    sum_weight: np.ndarray,
) -> None:
    """Add one view's samples in two bands; a slot occurs once a view.

    Where all sixteen pixels around are usable the value is a cubic, which keeps the finest detail
    that a bilinear one halves, held to those pixels' range; elsewhere bilinear over usable ones.

    Args:
        image: (h, w, c) float32.
        usable: (h, w) bool.
        low_sums: of `LowBand`, as are the next two.
        low_counts: its counts.
        low_step: its step.
        slot: (k,) int32 into the sums.
        pixel: (k, 2) float32, the first pixel's centre at 0.5.
        weight: (k,) float32.
        power: on the weights of the fine band.
        sum_low: (n, c) float32, added to.
        sum_fine: (n, c), the same of the fine band.
        sum_weight: (n, 2), of both bands.
    """
    height, width, channels = image.shape
    low_height, low_width = low_counts.shape
    for k in numba.prange(len(slot)):
        x, y = pixel[k, 0] - 0.5, pixel[k, 1] - 0.5
        left, top = int(np.floor(x)), int(np.floor(y))
        tx, ty = x - left, y - top
        covered = 0.0
        for dy in range(2):
            for dx in range(2):
                row, column = top + dy, left + dx
                if 0 <= row < height and 0 <= column < width and usable[row, column]:
                    covered += (tx if dx else 1 - tx) * (ty if dy else 1 - ty)
        if covered < LEAST_COVER:
            continue
        whole = left >= 1 and left + 2 < width and top >= 1 and top + 2 < height
        if whole:
            for dy in range(-1, 3):
                for dx in range(-1, 3):
                    whole = whole and usable[top + dy, left + dx]
        # The low band's cells have their centres at (i + 1/2) steps.
        lx = (x + 0.5) / low_step - 0.5
        ly = (y + 0.5) / low_step - 0.5
        low_left, low_top = int(np.floor(lx)), int(np.floor(ly))
        ux, uy = lx - low_left, ly - low_top
        low_covered = 0.0
        for dy in range(2):
            for dx in range(2):
                row, column = low_top + dy, low_left + dx
                if 0 <= row < low_height and 0 <= column < low_width:
                    share = (ux if dx else 1 - ux) * (uy if dy else 1 - uy)
                    low_covered += share * low_counts[row, column]
        s = slot[k]
        coarse_weight = weight[k]
        fine_weight = coarse_weight**power
        sum_weight[s, 0] += coarse_weight
        sum_weight[s, 1] += fine_weight
        for c in range(channels):
            value, coarse = 0.0, 0.0
            if whole:
                least, most = np.inf, -np.inf
                for dy in range(4):
                    line = 0.0
                    for dx in range(4):
                        tap = image[top + dy - 1, left + dx - 1, c]
                        least, most = min(least, tap), max(most, tap)
                        line += _cubic(tx, dx) * tap
                    value += _cubic(ty, dy) * line
                value = min(max(value, least), most)
            else:
                for dy in range(2):
                    for dx in range(2):
                        row, column = top + dy, left + dx
                        if 0 <= row < height and 0 <= column < width and usable[row, column]:
                            share = (tx if dx else 1 - tx) * (ty if dy else 1 - ty)
                            value += share * image[row, column, c] / covered
            for dy in range(2):
                for dx in range(2):
                    row, column = low_top + dy, low_left + dx
                    if 0 <= row < low_height and 0 <= column < low_width:
                        share = (ux if dx else 1 - ux) * (uy if dy else 1 - uy)
                        coarse += share * low_sums[row, column, c]
            # Without a low band here the value is all low.
            coarse = coarse / low_covered if low_covered > 1e-6 else value
            sum_low[s, c] += coarse_weight * coarse
            sum_fine[s, c] += fine_weight * (value - coarse)
