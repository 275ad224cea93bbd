"""A picture's values at places between its pixels."""

from __future__ import annotations

import cv2
import numpy as np

MOST_PLACES = 30_000
"""Sampled at once: OpenCV's maps have fewer than 32,767 rows."""


def averaged(rgb: np.ndarray, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """A picture of the means of so many pixels a side, and (2,) by which places in it are fewer."""
    if pixels <= 1:
        return rgb, np.ones(2)
    height, width = rgb.shape[:2]
    size = (max(1, width // pixels), max(1, height // pixels))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    return small, np.array([size[0] / width, size[1] / height])


def sampled(image: np.ndarray, places_px: np.ndarray) -> np.ndarray:
    """Bilinear values of an image at places, the border's beyond it.

    Args:
        image: (h, w) or (h, w, c). OpenCV rounds places in float64 images to 1/32 of a pixel, so
            they are sampled as float32.
        places_px: (s, 2), the first pixel's middle at (0.5, 0.5).

    Returns:
        (s) or (s, c) float32.
    """
    at = np.clip(places_px - 0.5, -1e4, 3e4).astype(np.float32)
    image = image.astype(np.float32, copy=False)
    out = np.zeros((len(at), *image.shape[2:]), np.float32)
    for start in range(0, len(at), MOST_PLACES):
        part = at[start : start + MOST_PLACES]
        found = cv2.remap(
            image, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        out[start : start + MOST_PLACES] = found[:, 0]
    return out
