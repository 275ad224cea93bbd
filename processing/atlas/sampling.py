"""Reading a view's maps at texels: sharply for detail, from a small blurred copy for the low band.

All maps of a view are read at once: a pixel's channels are side by side, so that a texel's place
and the pixels that serve it are computed once and not for every map.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numba
import numpy as np

from lightstage.formats.half import as_float
from processing.lanes import LANES, at_least, at_most, every, load, load_row, store

LEAST_COVER = 0.25
"""A texel whose bilinear neighbourhood holds less usable share than this is not read."""
SHARPNESS = -0.7
"""The cubic's free number. Averaged over places between pixels, -0.5 takes 27 % of the energy from
waves three pixels long and 8 % from those of four and a half; -0.7 takes 22 and 1 %, and gives at
most 2 % to longer ones."""


CLOSED, USABLE, SURROUNDED = 0, 1, 2
"""The values of `readable` for a pixel."""


class Reading(NamedTuple):
    """Where a view is read.

    Attributes:
        usable: (h, w) uint8 of `readable`.
        slot: (k,) int32 texel of each sample, each at most once.
        pixel: (k, 2) float32, the first pixel's centre at 0.5.
        weight: (k,) float32.
    """

    usable: np.ndarray
    slot: np.ndarray
    pixel: np.ndarray
    weight: np.ndarray


class Sharing(NamedTuple):
    """How views share the fine band.

    Attributes:
        best: (n,) float32, the largest weight that any view has at a texel.
        power: on the weights.
        least: share of the best weight; samples below add nothing to the fine band.
    """

    best: np.ndarray
    power: float
    least: float


class LowBand(NamedTuple):
    """A picture's masked Gaussian blur, on a grid as coarse as the blur allows.

    Attributes:
        sums: (h, w, c) float32, blurred values of usable pixels.
        counts: (h, w) float32, the same of ones.
        step: pixels of the picture per cell of the grid.
    """

    sums: np.ndarray
    counts: np.ndarray
    step: int


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
    # What is beyond the picture counts as closed.
    inner = cv2.erode(
        plain, window, anchor=(1, 1), borderType=cv2.BORDER_CONSTANT, borderValue=(0.0,)
    )
    return np.add(plain, np.asarray(inner), out=plain)


def room(channels: int) -> int:
    """Numbers a pixel of `side_by_side` takes: as many, or what the processor takes at once."""
    return max(channels, LANES)


def side_by_side(pictures: Iterable[np.ndarray], channels: int) -> np.ndarray:
    """All channels of all pictures, a pixel's one after the other.

    Args:
        pictures: (h, w) or (h, w, c) float16 each; one is released before the next is read.
        channels: of all of them.

    Returns:
        (h, w, room(channels)) uint16, the half floats' bits; zeros in what is left over.
    """
    out = np.zeros((0, 0, 0), np.uint16)
    first = 0
    for picture in pictures:
        if first == 0:
            out = np.empty((*picture.shape[:2], room(channels)), np.uint16)
        deep = picture.reshape(*picture.shape[:2], -1)
        _lay(deep.view(np.uint16), first, out)
        first += deep.shape[2]
    out[..., first:] = 0
    return out


@numba.njit(cache=True, nogil=True)
def _lay(picture: np.ndarray, first: int, out: np.ndarray) -> None:
    height, width, channels = picture.shape
    for row in range(height):
        for column in range(width):
            for c in range(channels):
                out[row, column, first + c] = picture[row, column, c]


def low_band(image: np.ndarray, usable: np.ndarray, sigma_px: float) -> LowBand:
    """Blur the usable part alone.

    Blurred pictures need few samples: at full size a kernel of 3 mm has hundreds of taps.

    Args:
        image: (h, w, c) uint16, half floats' bits, anything outside `usable`.
        usable: (h, w) of any type, 0 where nothing may be read.
        sigma_px: of the Gaussian.

    Returns:
        LowBand; its blur has the variance that was requested, the cells' own included.
    """
    step = max(1, int(sigma_px / 3))
    height, width, channels = image.shape
    shape = (-(-height // step), -(-width // step))
    sums = np.zeros((*shape, channels), np.float32)
    counts = np.zeros(shape, np.float32)
    _decimate(image, usable, step, sums, counts)
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
    area = np.float32(1.0 / (step * step))
    for row in numba.prange(counts.shape[0]):
        for y in range(row * step, min((row + 1) * step, height)):
            for x in range(width):
                if usable[y, x]:
                    column = x // step
                    counts[row, column] += area
                    for c in range(channels):
                        sums[row, column, c] += area * as_float(image[y, x, c])


@numba.njit(cache=True, nogil=True)
def widen(image: np.ndarray, usable: np.ndarray, least: np.ndarray, most: np.ndarray) -> None:
    """Widen each channel's range, in place, to the usable pixels of a view.

    Args:
        image: (h, w, d) of `side_by_side`.
        usable: (h, w) of `readable`.
        least: (d,) float32.
        most: (d,) float32.
    """
    for row in range(usable.shape[0]):
        for column in range(usable.shape[1]):
            if usable[row, column]:
                for c in range(len(least)):
                    value = as_float(image[row, column, c])
                    least[c] = min(least[c], value)
                    most[c] = max(most[c], value)


@numba.njit(cache=True, parallel=True)
def hold(values: np.ndarray, total: np.ndarray, least: np.ndarray, most: np.ndarray) -> None:
    """Hold the texels that some view shows to each channel's range, in place.

    Args:
        values: (n, d) float32.
        total: (n, 2) float32 of `weigh_up`.
        least: (d,) float32.
        most: (d,) float32.
    """
    for k in numba.prange(len(values)):
        if total[k, 0] > 0:
            for c in range(values.shape[1]):
                values[k, c] = min(max(values[k, c], least[c]), most[c])


@numba.njit(cache=True, inline="always")
def _cubic(t: float, k: int) -> float:
    """Weight of tap k of four under Keys's cubic convolution [Keys1981], t past the second."""
    x = abs(t + 1 - k)
    if x < 1:
        return 1.0 + x * x * ((SHARPNESS + 2.0) * x - (SHARPNESS + 3.0))
    return SHARPNESS * (x * (x * (x - 5.0) + 8.0) - 4.0)


@numba.njit(cache=True, inline="always")
def _share(dx: int, dy: int, tx: float, ty: float) -> float:
    """Weight of one of the four pixels around a place."""
    return (tx if dx else 1 - tx) * (ty if dy else 1 - ty)


@numba.njit(cache=True)
def _cover(usable: np.ndarray, left: int, top: int, tx: float, ty: float) -> np.float32:
    """Usable share of the four pixels around a place."""
    height, width = usable.shape
    covered = np.float32(0)
    for dy in range(2):
        for dx in range(2):
            row, column = top + dy, left + dx
            if 0 <= row < height and 0 <= column < width and usable[row, column]:
                covered += np.float32(_share(dx, dy, tx, ty))
    return covered


@numba.njit(cache=True)
def _place(pixel: np.ndarray, k: int) -> tuple[int, int, float, float]:
    """The pixel left above a sample, and the sample's distance from that pixel's centre."""
    half = np.float32(0.5)
    x, y = pixel[k, 0] - half, pixel[k, 1] - half
    left, top = int(np.floor(x)), int(np.floor(y))
    return left, top, x - np.float32(left), y - np.float32(top)


@numba.njit(cache=True, parallel=True)
def weigh_up(reading: Reading, sharing: Sharing, total: np.ndarray) -> None:
    """Add one view's weights of both bands; samples that cannot be read count nothing.

    Args:
        reading: where the view is read.
        sharing: of the fine band.
        total: (n, 2) float32, added to.
    """
    for k in numba.prange(len(reading.slot)):
        left, top, tx, ty = _place(reading.pixel, k)
        slot, weight = reading.slot[k], reading.weight[k]
        if _cover(reading.usable, left, top, tx, ty) < LEAST_COVER:
            continue
        total[slot, 0] += weight
        if weight >= sharing.least * sharing.best[slot]:
            total[slot, 1] += weight**sharing.power


@numba.njit(cache=True, parallel=True)
def accumulate(
    image: np.ndarray,
    low: LowBand,
    reading: Reading,
    sharing: Sharing,
    total: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add one view's share of both bands.

    Where all sixteen pixels around are usable the value is a cubic, which keeps the finest detail
    that a bilinear one halves, held to those pixels' range; elsewhere bilinear over usable ones.

    Args:
        image: (h, w, d) of `side_by_side`.
        low: its low band.
        reading: where it is read.
        sharing: of the fine band.
        total: (n, 2) float32 that `weigh_up` left.
        out: (n, d) float32, added to.
    """
    # Eight channels at a time; the last eight begin earlier where their number is no multiple, and
    # those that were added before are then taken times 0.
    once = np.ones(2 * LANES, np.float32)
    once[:LANES] = 0
    for k in numba.prange(len(reading.slot)):
        _add_sample(image, low, reading, sharing, total, once, out, np.int64(k))


@numba.njit(cache=True)
def _add_sample(
    image: np.ndarray,
    low: LowBand,
    reading: Reading,
    sharing: Sharing,
    total: np.ndarray,
    once: np.ndarray,
    out: np.ndarray,
    k: int,
) -> None:
    slot, weight, usable = reading.slot[k], reading.weight[k], reading.usable
    height, width = usable.shape
    left, top, tx, ty = _place(reading.pixel, k)
    whole = 0 <= left < width and 0 <= top < height and usable[top, left] == SURROUNDED
    covered = np.float32(1) if whole else _cover(usable, left, top, tx, ty)
    if not weight > 0 or covered < LEAST_COVER:
        return
    fine = np.float32(0)
    if weight >= sharing.least * sharing.best[slot]:
        square = weight * weight
        power = square * square if sharing.power == 4.0 else weight**sharing.power
        fine = np.float32(power / total[slot, 1])
    wide = weight / total[slot, 0]
    # The low band's cells have their centres at (i + 1/2) steps.
    half, step = np.float32(0.5), np.float32(low.step)
    lx, ly = reading.pixel[k, 0] / step - half, reading.pixel[k, 1] / step - half
    low_left, low_top = int(np.floor(lx)), int(np.floor(ly))
    ux, uy = lx - np.float32(low_left), ly - np.float32(low_top)
    low_height, low_width = low.counts.shape
    low_covered = np.float32(0)
    for dy in range(2):
        for dx in range(2):
            row, column = low_top + dy, low_left + dx
            if 0 <= row < low_height and 0 <= column < low_width:
                low_covered += np.float32(_share(dx, dy, ux, uy)) * low.counts[row, column]
    has_low = low_covered > 1e-6
    x0, x1 = every(np.float32(_cubic(tx, 0))), every(np.float32(_cubic(tx, 1)))
    x2, x3 = every(np.float32(_cubic(tx, 2))), every(np.float32(_cubic(tx, 3)))
    depth = image.shape[2]
    for begin in range(0, depth, LANES):
        first = min(begin, depth - LANES)
        value = every(np.float32(0))
        if (fine > 0 or not has_low) and whole:
            at = ((top - 1) * width + left - 1) * depth + first
            least = load_row(image, at)
            most = least
            for dy in range(4):
                a, b = load_row(image, at), load_row(image, at + depth)
                d, e = load_row(image, at + 2 * depth), load_row(image, at + 3 * depth)
                least = at_most(least, at_most(at_most(a, b), at_most(d, e)))
                most = at_least(most, at_least(at_least(a, b), at_least(d, e)))
                along = every(np.float32(_cubic(ty, dy)))
                value = value + along * (x0 * a + x1 * b + x2 * d + x3 * e)
                at += width * depth
            value = at_most(at_least(value, least), most)
        elif fine > 0 or not has_low:
            for dy in range(2):
                for dx in range(2):
                    row, column = top + dy, left + dx
                    if 0 <= row < height and 0 <= column < width and usable[row, column]:
                        share = np.float32(_share(dx, dy, tx, ty) / covered)
                        at = (row * width + column) * depth + first
                        value = value + every(share) * load_row(image, at)
        if has_low:
            coarse = every(np.float32(0))
            for dy in range(2):
                for dx in range(2):
                    row, column = low_top + dy, low_left + dx
                    if 0 <= row < low_height and 0 <= column < low_width:
                        share = np.float32(_share(dx, dy, ux, uy) / low_covered)
                        at = (row * low_width + column) * depth + first
                        coarse = coarse + every(share) * load(low.sums, at)
            value = every(wide) * coarse + every(fine) * (value - coarse)
        else:
            # Without a low band here the value is all low.
            value = every(wide) * value
        at = slot * depth + first
        store(out, at, load(out, at) + load(once, LANES + first - begin) * value)
