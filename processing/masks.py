"""Masks from photographs: what was lit, and how far a pixel is from a mask's edge."""

from __future__ import annotations

import cv2
import numpy as np

from processing.dim_regions import dim_regions
from processing.frames.window import Window


def foreground(brightest: np.ndarray, share: float, picture_share: float = 1.0) -> np.ndarray:
    """What is in front of the dark background: the largest bright region, and dark ones beside it.

    Their holes are filled.

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
    largest = _filled(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))
    return _filled(largest | dim_regions(smooth, largest, share * level))


def view_foreground(
    bright: np.ndarray, side: int, window: Window, shape: tuple[int, int], share: float
) -> np.ndarray:
    """The foreground of one camera's photographs, in their window.

    Args:
        bright: (h // side, w // side) of `SmallPictures`.
        side: pixels of its squares.
        window: (h, w) of the photographs.
        shape: rows and columns of the whole picture.
        share: see `foreground`.

    Returns:
        (h, w) bool of the window.
    """
    height, width = window.shape
    mask = foreground(bright, share, height * width / (shape[0] * shape[1]))
    if side == 1:
        return mask
    # Between the squares' middles the mask is interpolated: no steps at its edge.
    grown = np.empty((height, width), np.uint8)
    size = (bright.shape[1] * side, bright.shape[0] * side)
    grown[: size[1], : size[0]] = cv2.resize(
        mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_LINEAR
    )
    grown[size[1] :, : size[0]] = grown[size[1] - 1, : size[0]]
    grown[:, size[0] :] = grown[:, size[0] - 1 : size[0]]
    return np.asarray(grown > 127)


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
