"""Light that wanders inside the skin and leaves elsewhere than it entered."""

from __future__ import annotations

import cv2
import numpy as np

from processing.refinement.joint import Scattered

VARIANCES_MM2 = (0.0064, 0.0484, 0.187, 0.567, 1.99, 7.41)
WEIGHTS = np.array(
    [
        [0.233, 0.455, 0.649],
        [0.100, 0.336, 0.344],
        [0.118, 0.198, 0.000],
        [0.113, 0.007, 0.007],
        [0.358, 0.004, 0.000],
        [0.078, 0.000, 0.000],
    ]
)
"""Skin's profile as Gaussians: variance, and weight in red, green and blue [DEon2007]."""
NARROWEST_PX = 0.25
"""A Gaussian of less stays within its pixel."""


def unscattered(count: int, patterns: int) -> Scattered:
    """All light leaves where it entered, at so many pixels."""
    return Scattered(np.ones(3), np.zeros((count, patterns, 3), np.float32))


def scattered(
    irradiance: np.ndarray, mask: np.ndarray, px_per_mm: float, amount: float
) -> Scattered:
    """What neighbours give to the diffuse light of each pixel.

    Args:
        irradiance: (n, P) of the mask's pixels, in row order; zero where it is not known.
        mask: (h, w) bool with n true pixels.
        px_per_mm: pixels a millimetre.
        amount: share of the light that wanders with skin's whole profile; the rest leaves where it
            entered.

    Source: [DEon2007].
    """
    count, patterns = irradiance.shape
    if amount == 0:
        return unscattered(count, patterns)
    rest = np.zeros((count, patterns, 3), np.float32)
    there = irradiance.max(axis=1) > 0
    planes = np.zeros((patterns + 1, *mask.shape), np.float32)
    planes[:-1, mask] = irradiance.T
    planes[-1, mask] = there
    kept = np.full(3, 1.0 - amount)
    weights = amount * WEIGHTS / WEIGHTS.sum(axis=0)
    for variance, weight in zip(VARIANCES_MM2, weights, strict=True):
        sigma_px = px_per_mm * float(np.sqrt(variance))
        if sigma_px < NARROWEST_PX:
            kept += weight
            continue
        size = 2 * int(np.ceil(4 * sigma_px)) + 1
        own = float(cv2.getGaussianKernel(size, sigma_px).max()) ** 2
        kept += weight * own
        border = cv2.BORDER_CONSTANT
        near = [cv2.GaussianBlur(x, (0, 0), sigma_px, borderType=border)[mask] for x in planes]
        total = np.maximum(near[-1], np.float32(own))
        for k in range(patterns):
            others = near[k] / total - np.float32(own) * irradiance[:, k]
            for c in range(3):
                if weight[c] > 0:
                    rest[:, k, c] += np.float32(weight[c]) * others
    rest[~there] = 0
    return Scattered(kept, rest)
