"""Masks from photographs: what was lit, and how far a pixel is from a mask's edge."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit, prange

from processing.frames.halves import as_float
from processing.frames.read import Frames

SMALL_PX = 2_000_000
"""A foreground is looked for in about this many pixels, and in means of squares where there are
more."""


def foreground(brightest: np.ndarray, share: float, picture_share: float = 1.0) -> np.ndarray:
    """What stands before the dark background: the largest bright region, its holes filled.

    Args:
        brightest: (h, w) the largest value of a pixel over patterns and channels.
        share: a pixel is bright above this share of the 99th percentile of the picture.
        picture_share: share of the whole picture that `brightest` is; the rest is darker.

    Returns:
        (h, w) bool; all false when the picture is black.
    """
    level = float(np.percentile(brightest, 100 * max(0.0, 1 - 0.01 / picture_share)))
    if level <= 0:
        return np.zeros(brightest.shape, bool)
    # A median keeps single noisy background pixels from growing into regions.
    smooth = cv2.medianBlur(brightest.astype(np.float32), 5)
    bright = (smooth > share * level).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright)
    if count < 2:
        return np.zeros(brightest.shape, bool)
    largest = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return _filled(largest)


def view_foreground(frames: Frames, share: float) -> np.ndarray:
    """The foreground of one camera's photographs, in their window.

    Args:
        frames: of which what is clipped counts as it reads.
        share: see `foreground`.

    Returns:
        (h, w) bool of the window.
    """
    height, width = frames.window.shape
    side = max(1, round(float(np.sqrt(height * width / SMALL_PX))))
    bits = np.asarray(frames.half).view(np.uint16)
    means = np.zeros((height // side, width // side), np.float32)
    _brightest(bits, side, means)
    area = frames.shape[0] * frames.shape[1]
    mask = foreground(means, share, height * width / area)
    if side == 1:
        return mask
    # Between the squares' middles the mask is interpolated: no steps at its edge.
    grown = np.empty((height, width), np.uint8)
    size = (means.shape[1] * side, means.shape[0] * side)
    grown[: size[1], : size[0]] = cv2.resize(
        mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_LINEAR
    )
    grown[size[1] :, : size[0]] = grown[size[1] - 1, : size[0]]
    grown[:, size[0] :] = grown[:, size[0] - 1 : size[0]]
    return np.asarray(grown > 127)


@njit(parallel=True, cache=True)
def _brightest(bits: np.ndarray, side: int, out: np.ndarray) -> None:
    """Means over squares of the largest value over patterns and colours."""
    for row in prange(out.shape[0]):
        width = out.shape[1] * side
        best = np.empty(width * 3, np.float32)
        sums = np.zeros(width, np.float32)
        for y in range(row * side, (row + 1) * side):
            best[:] = -np.inf
            for k in range(bits.shape[0]):
                line = bits[k, y].reshape(-1)
                for i in range(len(best)):
                    best[i] = max(best[i], as_float(line[i]))
            for x in range(width):
                sums[x] += max(best[3 * x], max(best[3 * x + 1], best[3 * x + 2]))
        for column in range(out.shape[1]):
            total = np.float32(0)
            for x in range(column * side, (column + 1) * side):
                total += sums[x]
            out[row, column] = total / np.float32(side * side)


def _filled(mask: np.ndarray) -> np.ndarray:
    """A mask and its holes: what of the rest does not reach the picture's border by its sides."""
    rest = (~mask).astype(np.uint8)
    _, labels = cv2.connectedComponents(rest, connectivity=4)
    outside = np.zeros(int(labels.max()) + 1, bool)
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        outside[edge] = True
    outside[0] = False  # label 0 is the mask itself
    return np.asarray(~outside[labels])


def edge_distance_px(mask: np.ndarray) -> np.ndarray:
    """(h, w) float32: distance in pixels of a mask's pixels to the nearest pixel outside it.

    The picture's border is no edge.
    """
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5))
