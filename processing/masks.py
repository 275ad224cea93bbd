"""Masks from photographs: what was lit, and how far a pixel is from a mask's edge."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage


def foreground(brightest: np.ndarray, share: float) -> np.ndarray:
    """What stands before the dark background: the largest bright region, its holes filled.

    Args:
        brightest: (h, w) the largest value of a pixel over patterns and channels.
        share: a pixel is bright above this share of the 99th percentile of the picture.

    Returns:
        (h, w) bool; all false when the picture is black.
    """
    level = float(np.percentile(brightest, 99))
    if level <= 0:
        return np.zeros(brightest.shape, bool)
    # A median keeps single noisy background pixels from growing into regions.
    smooth = cv2.medianBlur(brightest.astype(np.float32), 5)
    bright = (smooth > share * level).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright)
    if count < 2:
        return np.zeros(brightest.shape, bool)
    largest = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return np.asarray(ndimage.binary_fill_holes(largest))


def edge_distance_px(mask: np.ndarray) -> np.ndarray:
    """(h, w) float32: distance in pixels of a mask's pixels to the nearest pixel outside it.

    The picture's border is no edge.
    """
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5))
