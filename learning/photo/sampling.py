"""A picture's values at places between its pixels."""

from __future__ import annotations

import cv2
import numpy as np

MOST_PLACES = 30_000
"""Sampled at once: OpenCV's maps have fewer than 32,767 rows."""


def sampled(image: np.ndarray, places_px: np.ndarray) -> np.ndarray:
    """Bilinear values of an image at places, the border's beyond it.

    Args:
        image: (h, w) or (h, w, c), float32 or float64.
        places_px: (s, 2), the first pixel's middle at (0.5, 0.5).

    Returns:
        (s) or (s, c) in the image's type.
    """
    at = np.clip(places_px - 0.5, -1e4, 3e4).astype(np.float32)
    out = np.zeros((len(at), *image.shape[2:]), image.dtype)
    for start in range(0, len(at), MOST_PLACES):
        part = at[start : start + MOST_PLACES]
        found = cv2.remap(
            image, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        out[start : start + MOST_PLACES] = found[:, 0]
    return out
