"""Masks of pixels or texels."""

from __future__ import annotations

import cv2
import numpy as np


def widened(mask: np.ndarray, reach: int) -> np.ndarray:
    """(h, w) bool, a mask of that shape and all that is within a disc of that radius of it."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc) > 0)
