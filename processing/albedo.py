"""Diffuse and specular albedo from what a pixel reads, once its light is known.

It is no method of separation: those are in separation/, listed in separation/choice.py.
"""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np

NARROWEST_PX = 0.1
"""A narrower Gaussian, as of sigma 0, leaves each pixel its own value: so does this one."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Each pixel's least squares for its specular albedo s alone: s is weighed / weight.

    Attributes:
        weighed: (n,) float64, the lobe's part of the reading times `weight`'s root.
        weight: (n,) float64, how strongly the reading depends on s.
        power: (n,) float64, what the diffuse part alone leaves unexplained, squared.
    """

    weighed: np.ndarray
    weight: np.ndarray
    power: np.ndarray


def specular_evidence(mean: np.ndarray, irradiance: np.ndarray, lobe: np.ndarray) -> Evidence:
    """Eliminate the diffuse albedo from mean_k = rho E_k + s B_k and leave s.

    Args:
        mean: (n, P) mean channel of the readings, in the lights' own colour.
        irradiance: (n, P) E_k.
        lobe: (n, P) B_k.

    Returns:
        Evidence; weight 0 where a pixel receives nothing or is not finite.
    """
    e = irradiance.astype(np.float64)
    power = np.einsum("np,np->n", e, e)
    lit = power > 0
    e = e / np.sqrt(np.where(lit, power, 1))[:, None]
    reading = mean.astype(np.float64)
    across = lobe - e * np.einsum("np,np->n", e, lobe)[:, None]
    weighed = np.einsum("np,np->n", across, reading)
    weight = np.einsum("np,np->n", across, across)
    left = np.einsum("np,np->n", reading, reading) - np.einsum("np,np->n", e, reading) ** 2
    good = lit & np.isfinite(weighed) & np.isfinite(weight) & np.isfinite(left)
    return Evidence(*(np.where(good, x, 0) for x in (weighed, weight, np.maximum(left, 0))))


def diffuse_light(
    rgb: np.ndarray, irradiance: np.ndarray, lobe: np.ndarray, specular: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of the diffuse albedo with the specular part taken off: lit / power.

    Args:
        rgb: (n, P, 3) readings, in the lights' own colour.
        irradiance, lobe: (n, P) E_k and B_k.
        specular: (n,) s.

    Returns:
        (n, 3) float64 lit and (n,) float64 power, 0 where a pixel receives nothing.
    """
    e = irradiance.astype(np.float64)
    power = np.einsum("np,np->n", e, e)
    mirror = lobe * specular[:, None]
    lit = np.einsum("np,npc->nc", e, rgb) - np.einsum("np,np->n", e, mirror)[:, None]
    good = np.isfinite(lit).all(axis=1) & np.isfinite(power)
    return np.where(good[:, None], lit, 0), np.where(good, power, 0)


def diffuse_albedo(
    lit: np.ndarray, power: np.ndarray, mask: np.ndarray, sigma_px: float, prior_power: float
) -> np.ndarray:
    """Diffuse albedo; where hardly any light arrives, that of the neighbours.

    A crease that sees a few per cent of the sky would else turn an error of a thousandth of its
    reading into an albedo of forty.

    Args:
        lit, power: (n, 3), and (n,) or (n, 3), of `diffuse_light`, for the mask's pixels in row
            order; 0 where not to be used.
        mask: (h, w) bool with n true pixels.
        sigma_px: over which neighbours are averaged.
        prior_power: the neighbours count as much as this squared irradiance.

    Returns:
        (n, 3) float64, at least 0.
    """
    power = power.reshape(len(lit), -1)
    totals: dict[int, np.ndarray] = {}
    albedo = np.empty(lit.shape)
    # Channel by channel: at 24 megapixels all of them at once take a gigabyte.
    for c in range(lit.shape[1]):
        column = min(c, power.shape[1] - 1)
        if column not in totals:
            totals = {column: pooled(power[:, column], mask, sigma_px)}
        near, total = pooled(lit[:, c], mask, sigma_px), totals[column]
        prior = np.where(total > 0, near / np.where(total > 0, total, 1), 0)
        own = power[:, column]
        albedo[:, c] = np.maximum((lit[:, c] + prior_power * prior) / (own + prior_power), 0)
    return albedo


def pooled(values: np.ndarray, mask: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian sums of per-pixel values over their neighbours in a mask.

    A wide Gaussian is made of means over blocks of a quarter of its sigma, off by less than 1 % of
    the largest sum.

    Args:
        values: (n,) of the mask's pixels in row order.
        mask: (h, w) bool with n true pixels.
        sigma_px: of the Gaussian.

    Returns:
        (n,) float64 weighted sums (not divided by the weight inside the mask).
    """
    block = max(1, int(sigma_px / 4))
    rows, columns = (-(-side // block) * block for side in mask.shape)
    image = np.zeros((rows, columns), np.float64)
    image[: mask.shape[0], : mask.shape[1]][mask] = values
    if block == 1:
        sigma_px = max(sigma_px, NARROWEST_PX)
        blurred = cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(blurred[: mask.shape[0], : mask.shape[1]][mask], float)
    few = cv2.resize(image, (columns // block, rows // block), interpolation=cv2.INTER_AREA)
    # Means over blocks and lines between them blur, too: a quarter of a block squared.
    left = math.sqrt((sigma_px / block) ** 2 - 0.25)
    few = cv2.GaussianBlur(few, (0, 0), left, borderType=cv2.BORDER_CONSTANT)
    blurred = cv2.resize(few, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return np.asarray(blurred[: mask.shape[0], : mask.shape[1]][mask], float)


def shrunk(
    weighed: np.ndarray, weight: np.ndarray, prior: np.ndarray | float, prior_weight: float
) -> np.ndarray:
    """(n,) specular albedo with a prior: (weighed + w prior) / (weight + w), clipped to 0..0.2.

    `weighed` and `weight` are (n,), as is `prior` where it is no number.

    Reflectances above .2 are metals, not faces.
    """
    total = weight + prior_weight
    value = (weighed + prior * prior_weight) / np.where(total > 0, total, 1)
    return np.clip(np.where(total > 0, value, prior), 0.0, 0.2)
