"""Maps read at texture coordinates: cubic where all texels around hold something, else bilinear.

Where the new texels are larger than the old ones, a smaller copy is read, so that nothing finer
than the new texture is left to alias.
"""

from __future__ import annotations

import numba
import numpy as np


def halved(image: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A map of half the rows and columns: the mean of the covered texels of each four.

    Args:
        image: (rows, columns, c) float32.
        covered: (rows, columns) bool.
    """
    if min(covered.shape) < 2:
        return image, covered
    # Of an odd size the last row or column stays: without it all others would move.
    odd = [(0, size % 2) for size in covered.shape]
    covered, image = np.pad(covered, odd), np.pad(image, [*odd, (0, 0)])
    rows, columns = covered.shape[0] // 2, covered.shape[1] // 2
    share = covered.reshape(rows, 2, columns, 2)
    parts = image.reshape(rows, 2, columns, 2, -1)
    weight = share.sum(axis=(1, 3))
    total = (parts * share[..., None]).sum(axis=(1, 3))
    return (total / np.maximum(weight, 1)[..., None]).astype(np.float32), weight > 0


def sampled(
    image: np.ndarray,
    covered: np.ndarray,
    uv: np.ndarray,
    larger: np.ndarray,
    coarsest: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Values of a map at texture coordinates.

    Args:
        image: (rows, columns, c) float32; row 0 is v = 1.
        covered: (rows, columns) bool, texels that hold something.
        uv: (n, 2) finite.
        larger: (n,) so many times are the new texels as large as the old ones, along a side.
        coarsest: at most so many times is the map halved.

    Returns:
        (n, c) float32, and (n,) bool where any of the texels around is covered.
    """
    level = np.clip(np.round(np.log2(np.maximum(larger, 1e-6))), 0, coarsest).astype(int)
    out = np.zeros((len(uv), image.shape[2]), np.float32)
    there = np.zeros(len(uv), np.bool_)
    source, mask = np.ascontiguousarray(image, np.float32), np.ascontiguousarray(covered, np.bool_)
    # Of the texture, in texels of each copy; a copy of odd sizes is larger by half a texel.
    size = np.array(covered.shape, float)
    for each in range(int(level.max(initial=0)) + 1):
        some = np.flatnonzero(level == each)
        if len(some):
            values = np.zeros((len(some), image.shape[2]), np.float32)
            known = np.zeros(len(some), np.bool_)
            places = np.ascontiguousarray(uv[some], np.float64)
            _sample(source, mask, size / 2**each, places, values, known)
            out[some], there[some] = values, known
        source, mask = halved(source, mask)
    return out, there


def nearest(
    image: np.ndarray, covered: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same, with its shapes, of the nearest covered texel of the four around, for numbers
    that have no mean.
    """
    rows, columns = covered.shape
    x, y = uv[:, 0] * columns - 0.5, (1 - uv[:, 1]) * rows - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    best = np.full(len(uv), -1.0)
    place = np.zeros((2, len(uv)), int)
    for down in (0, 1):
        for right in (0, 1):
            row, column = np.clip(top + down, 0, rows - 1), np.clip(left + right, 0, columns - 1)
            share = abs(1 - down - (y - top)) * abs(1 - right - (x - left))
            better = covered[row, column] & (share > best)
            best[better] = share[better]
            place[:, better] = row[better], column[better]
    return np.asarray(image[place[0], place[1]], np.float32), best >= 0


@numba.njit(cache=True, parallel=True)
def _sample(
    image: np.ndarray,
    covered: np.ndarray,
    size: np.ndarray,
    uv: np.ndarray,
    out: np.ndarray,
    there: np.ndarray,
) -> None:
    rows, columns = covered.shape
    channels = image.shape[2]
    for n in numba.prange(len(uv)):
        x = min(max(uv[n, 0] * size[1] - 0.5, 0.0), columns - 1.0)
        y = min(max((1.0 - uv[n, 1]) * size[0] - 0.5, 0.0), rows - 1.0)
        left, top = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - left, y - top
        whole = 1 <= left < columns - 2 and 1 <= top < rows - 2
        if whole:
            for r in range(4):
                for c in range(4):
                    whole = whole and covered[top - 1 + r, left - 1 + c]
        total = 0.0
        for r in range(4) if whole else range(1, 3):
            for c in range(4) if whole else range(1, 3):
                row, column = min(top - 1 + r, rows - 1), min(left - 1 + c, columns - 1)
                if not covered[row, column]:
                    continue
                weight = _share(fy, r, whole) * _share(fx, c, whole)
                total += weight
                for k in range(channels):
                    out[n, k] += weight * image[row, column, k]
        there[n] = total > 1e-6
        for k in range(channels):
            if not there[n]:
                out[n, k] = 0.0
                continue
            out[n, k] /= total
            if whole:  # a cubic can pass beyond the texels: it stays in the range of the nearest
                low, high = image[top, left, k], image[top, left, k]
                for r in range(4):
                    for c in range(4):
                        value = image[top - 1 + r, left - 1 + c, k]
                        low, high = min(low, value), max(high, value)
                out[n, k] = min(max(out[n, k], low), high)


@numba.njit(cache=True, inline="always")
def _share(f: float, place: int, cubic: bool) -> float:
    """Weight of the texel at `place` (0..3; 1 and 2 are beside the point) at a fraction f.

    Cubic convolution with a = -1/2 [Keys1981], or linear.
    """
    d = abs(f - (place - 1))
    if not cubic:
        return 1.0 - d
    if d < 1.0:
        return 1.5 * d * d * d - 2.5 * d * d + 1.0
    return -0.5 * d * d * d + 2.5 * d * d - 4.0 * d + 2.0
