"""Diffuse and specular albedo from what a pixel reads, once its light is known."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What each pixel says of its specular albedo s: least squares in s alone is weighed / weight.

    Attributes:
        weighed: (n,) float64, the lobe's part of the reading times `weight`'s root.
        weight: (n,) float64, how strongly the reading depends on s.
    """

    weighed: np.ndarray
    weight: np.ndarray


def specular_evidence(
    mean: np.ndarray, irradiance: np.ndarray, offset: np.ndarray, lobe: np.ndarray
) -> Evidence:
    """Eliminate the diffuse albedo from mean_k = rho E_k + A_k + s B_k and leave s.

    Args:
        mean: (n, P) mean channel of the readings, in the lights' own colour.
        irradiance: (n, P) E_k.
        offset: (n, P) A_k.
        lobe: (n, P) B_k.

    Returns:
        Evidence; weight 0 where a pixel receives nothing or is not finite.
    """
    e = irradiance.astype(np.float64)
    power = np.einsum("np,np->n", e, e)
    lit = power > 0
    e = e / np.sqrt(np.where(lit, power, 1))[:, None]
    reading = mean.astype(np.float64) - offset
    across = lobe - e * np.einsum("np,np->n", e, lobe)[:, None]
    weighed = np.einsum("np,np->n", across, reading)
    weight = np.einsum("np,np->n", across, across)
    good = lit & np.isfinite(weighed) & np.isfinite(weight)
    return Evidence(np.where(good, weighed, 0), np.where(good, weight, 0))


def diffuse_albedo(
    rgb: np.ndarray,
    irradiance: np.ndarray,
    offset: np.ndarray,
    lobe: np.ndarray,
    specular: np.ndarray,
) -> np.ndarray:
    """Least squares of the diffuse albedo with the specular part taken off.

    Args:
        rgb: (n, P, 3) readings, in the lights' own colour.
        irradiance, offset, lobe: (n, P) E_k, A_k, B_k.
        specular: (n,) s.

    Returns:
        (n, 3) float64, at least 0; 0 where a pixel receives nothing.
    """
    e = irradiance.astype(np.float64)
    power = np.einsum("np,np->n", e, e)
    mirror = offset + lobe * specular[:, None]
    lit = np.einsum("np,npc->nc", e, rgb) - np.einsum("np,np->n", e, mirror)[:, None]
    safe = np.where(power > 0, power, 1)[:, None]
    albedo = np.where(power[:, None] > 0, lit / safe, 0)
    return np.where(np.isfinite(albedo), np.maximum(albedo, 0), 0)


def pooled(values: np.ndarray, mask: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian sums of per-pixel values over their neighbours in a mask.

    Args:
        values: (n,) of the mask's pixels in row order.
        mask: (h, w) bool with n true pixels.
        sigma_px: of the Gaussian.

    Returns:
        (n,) float64 weighted sums (not divided by the weight inside the mask).
    """
    image = np.zeros(mask.shape)
    image[mask] = values
    blurred = cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred[mask], float)


def shrunk(evidence: Evidence, prior: float, prior_weight: np.ndarray | float) -> np.ndarray:
    """Specular albedo with a prior: (weighed + w prior) / (weight + w), clipped to 0..0.2.

    Reflectances above .2 are metals, not faces.
    """
    total = evidence.weight + prior_weight
    value = (evidence.weighed + prior * prior_weight) / np.where(total > 0, total, 1)
    return np.clip(np.where(total > 0, value, prior), 0.0, 0.2)
