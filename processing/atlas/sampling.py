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


CLOSED, USABLE, SURROUNDED = 0, 1, 2
"""What `readable` says of a pixel."""


def readable(usable: np.ndarray) -> np.ndarray:
    """Which pixels may be read, and where a cubic may.

    Args:
        usable: (h, w) bool.

    Returns:
        (h, w) uint8: CLOSED, USABLE, or SURROUNDED where the pixel, the one before, and the two
        after it in both directions are usable: all sixteen taps of a place between it and the next.
    """
    plain = usable.astype(np.uint8)
    window = np.ones((4, 4), np.uint8)
    # What lies beyond the picture counts as closed.
    inner = cv2.erode(
        plain, window, anchor=(1, 1), borderType=cv2.BORDER_CONSTANT, borderValue=(0.0,)
    )
    return np.add(plain, np.asarray(inner), out=plain)


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
        usable: (h, w) of any type, 0 where nothing may be read.
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
def weigh_up(
    usable: np.ndarray,
    slot: np.ndarray,
    pixel: np.ndarray,
    weight: np.ndarray,
    best: np.ndarray,
    power: float,
    least_share: float,
    total: np.ndarray,
) -> None:
    """Add one view's weights of both bands; samples that cannot be read get the weight 0.

    Args:
        usable: (h, w) uint8 of `readable`.
        slot: (k,) int32, each at most once.
        pixel: (k, 2) float32, the first pixel's centre at 0.5.
        weight: (k,) float32, changed.
        best: (n,) float32, the largest weight that any view has there.
        power: on the weights of the fine band.
        least_share: of the best weight; samples below add nothing to the fine band.
        total: (n, 2) float32, added to.
    """
    height, width = usable.shape
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
            weight[k] = 0
            continue
        total[slot[k], 0] += weight[k]
        if weight[k] >= least_share * best[slot[k]]:
            total[slot[k], 1] += weight[k] ** power


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
    best: np.ndarray,
    power: float,
    least_share: float,
    total: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add one view's share of both bands; a slot occurs once a view.

    Where all sixteen pixels around are usable the value is a cubic, which keeps the finest detail
    that a bilinear one halves, held to those pixels' range; elsewhere bilinear over usable ones.

    Args:
        image: (h, w, c) float32.
        usable: (h, w) uint8 of `readable`.
        low_sums: of `LowBand`, as are the next two.
        low_counts: its counts.
        low_step: its step.
        slot: (k,) int32 into the sums.
        pixel: as `weigh_up` had it, as are the next four.
        weight: (k,) float32, 0 where nothing is to be read.
        best: (n,) float32.
        power: on the weights of the fine band.
        least_share: of the best weight.
        total: (n, 2) float32 that `weigh_up` left.
        out: (n, c) float32, added to.
    """
    height, width, channels = image.shape
    low_height, low_width = low_counts.shape
    fourth = power == 4.0
    half = np.float32(0.5)
    for k in numba.prange(len(slot)):
        here = weight[k]
        if not here > 0:
            continue
        s = slot[k]
        fine = np.float32(0)
        if here >= least_share * best[s]:
            square = here * here
            fine = np.float32((square * square if fourth else here**power) / total[s, 1])
        wide = here / total[s, 0]
        x, y = pixel[k, 0] - half, pixel[k, 1] - half
        left, top = int(np.floor(x)), int(np.floor(y))
        tx, ty = x - np.float32(left), y - np.float32(top)
        whole = 0 <= left < width and 0 <= top < height and usable[top, left] == SURROUNDED
        # The low band's cells have their centres at (i + 1/2) steps.
        lx = (x + half) / np.float32(low_step) - half
        ly = (y + half) / np.float32(low_step) - half
        low_left, low_top = int(np.floor(lx)), int(np.floor(ly))
        ux, uy = lx - np.float32(low_left), ly - np.float32(low_top)
        low_covered = np.float32(0)
        for dy in range(2):
            for dx in range(2):
                row, column = low_top + dy, low_left + dx
                if 0 <= row < low_height and 0 <= column < low_width:
                    share = (ux if dx else 1 - ux) * (uy if dy else 1 - uy)
                    low_covered += np.float32(share) * low_counts[row, column]
        has_low = low_covered > 1e-6
        read = fine > 0 or not has_low
        x0, x1 = np.float32(_cubic(tx, 0)), np.float32(_cubic(tx, 1))
        x2, x3 = np.float32(_cubic(tx, 2)), np.float32(_cubic(tx, 3))
        y0, y1 = np.float32(_cubic(ty, 0)), np.float32(_cubic(ty, 1))
        y2, y3 = np.float32(_cubic(ty, 2)), np.float32(_cubic(ty, 3))
        for c in range(channels):
            value, coarse = np.float32(0), np.float32(0)
            if whole and read:
                least, most = image[top, left, c], image[top, left, c]
                for dy in range(4):
                    row = top + dy - 1
                    a, b = image[row, left - 1, c], image[row, left, c]
                    d, e = image[row, left + 1, c], image[row, left + 2, c]
                    least = min(least, min(min(a, b), min(d, e)))
                    most = max(most, max(max(a, b), max(d, e)))
                    along = y0 if dy == 0 else y1 if dy == 1 else y2 if dy == 2 else y3
                    value += along * (x0 * a + x1 * b + x2 * d + x3 * e)
                value = min(max(value, least), most)
            elif read:
                covered = np.float32(0)
                for dy in range(2):
                    for dx in range(2):
                        row, column = top + dy, left + dx
                        if 0 <= row < height and 0 <= column < width and usable[row, column]:
                            share = np.float32((tx if dx else 1 - tx) * (ty if dy else 1 - ty))
                            value += share * image[row, column, c]
                            covered += share
                value /= covered
            if has_low:
                for dy in range(2):
                    for dx in range(2):
                        row, column = low_top + dy, low_left + dx
                        if 0 <= row < low_height and 0 <= column < low_width:
                            share = np.float32((ux if dx else 1 - ux) * (uy if dy else 1 - uy))
                            coarse += share * low_sums[row, column, c]
                coarse /= low_covered
                out[s, c] += wide * coarse + fine * (value - coarse)
            else:
                # Without a low band here the value is all low.
                out[s, c] += wide * value
