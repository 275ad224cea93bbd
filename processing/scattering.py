"""Light that wanders inside the skin: how far it calms what relief does to diffuse light."""

from __future__ import annotations

import cv2
import numpy as np

from processing.joint import Scattered

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


def scattered(normals: np.ndarray, mask: np.ndarray, px_per_mm: float, amount: float) -> Scattered:
    """What neighbours' normals give to the diffuse light of each pixel.

    Args:
        normals: (n, 3) unit of the mask's pixels, in row order; zero where there is none.
        mask: (h, w) bool with n true pixels.
        px_per_mm: pixels a millimetre.
        amount: share of the light that wanders with skin's whole profile; the rest leaves where it
            entered.

    Source: [DEon2007].
    """
    count = len(normals)
    rest = np.zeros((count, 3, 3), np.float32)
    if amount == 0:
        return Scattered(np.ones(3), rest)
    there = np.einsum("nk,nk->n", normals, normals) > 0.5
    image = np.zeros((*mask.shape, 4), np.float32)
    image[mask] = np.column_stack([normals, there])
    kept = np.full(3, 1.0 - amount)
    weights = amount * WEIGHTS / WEIGHTS.sum(axis=0)
    for variance, weight in zip(VARIANCES_MM2, weights, strict=True):
        sigma_px = px_per_mm * float(np.sqrt(variance))
        if sigma_px < NARROWEST_PX:
            kept += weight
            continue
        size = 2 * int(np.ceil(4 * sigma_px)) + 1
        own = float(cv2.getGaussianKernel(size, sigma_px).max()) ** 2
        near = cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)[mask]
        mean = near[:, :3] / np.maximum(near[:, 3:], 1e-3) - own * normals
        kept += weight * own
        for c in range(3):
            rest[:, c] += np.float32(weight[c]) * mean
    rest[~there] = 0
    return Scattered(kept, rest)
