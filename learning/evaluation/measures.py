"""What is measured of one person's inferred maps, texel by texel, over skin."""

from __future__ import annotations

import cv2
import numpy as np

from learning.vectors import unit
from processing.colour import srgb_from_linear
from processing.evaluation.maps import angle_deg, psnr_db

SSIM_SIGMA, SSIM_REACH = 1.5, 5
"""Gaussian window of structural similarity and its half width, texels [Wang2004]."""
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
LEAST = 1e-12


def scaled(found: np.ndarray, true: np.ndarray, by_channel: bool) -> np.ndarray:
    """Albedo brought to the truth's mean: by one factor, or by one for each channel.

    Args:
        found: (n, 3) linear.
        true: (n, 3) linear.
        by_channel: a factor a channel, which leaves the pattern alone.
    """
    axis = 0 if by_channel else None
    return np.asarray(found * true.mean(axis=axis) / np.maximum(found.mean(axis=axis), LEAST))


def albedo_measures(found: np.ndarray, true: np.ndarray, skin: np.ndarray) -> dict[str, float]:
    """PSNR, mean square and structural similarity of albedo, sRGB-encoded.

    Args:
        found: (rows, columns, 3) linear.
        true: (rows, columns, 3) linear.
        skin: (rows, columns) bool, what is measured.

    Returns:
        ``albedo_psnr_db`` raw, ``albedo_scaled_psnr_db`` after one factor,
        ``albedo_relative_psnr_db`` after one a channel, ``albedo_mse``, ``albedo_ssim``.
    """
    mine, theirs = found[skin].astype(float), true[skin].astype(float)
    encoded = srgb_from_linear(theirs)

    def compared(values: np.ndarray) -> float:
        return psnr_db(srgb_from_linear(values), encoded)

    mse = float(((srgb_from_linear(mine) - encoded) ** 2).mean())
    return {
        "albedo_psnr_db": compared(mine),
        "albedo_scaled_psnr_db": compared(scaled(mine, theirs, by_channel=False)),
        "albedo_relative_psnr_db": compared(scaled(mine, theirs, by_channel=True)),
        "albedo_mse": mse,
        "albedo_ssim": ssim(srgb_from_linear(found), srgb_from_linear(true), skin),
    }


def normal_measures(
    name: str, found: np.ndarray, true: np.ndarray, skin: np.ndarray
) -> dict[str, float]:
    """Degrees between normals, mean and median, and PSNR of normals encoded as (n + 1) / 2.

    A found normal that is missing, zero, is 90 degrees off: no map gains by leaving out what is
    hard.

    Args:
        name: of the map, with which the figures' names begin.
        found: (rows, columns, 3).
        true: (rows, columns, 3) unit.
        skin: (rows, columns) bool, what is measured.
    """
    mine, theirs = (unit(normals[skin].astype(float)) for normals in (found, true))
    known = np.linalg.norm(theirs, axis=1) > 0.5
    if not known.any():
        return {}
    mine, theirs = mine[known], theirs[known]
    angle = angle_deg(mine, theirs)
    return {
        f"{name}_mean_deg": float(angle.mean()),
        f"{name}_median_deg": float(np.median(angle)),
        f"{name}_psnr_db": psnr_db((mine + 1) / 2, (theirs + 1) / 2),
    }


def specular_measures(found: np.ndarray, true: np.ndarray, skin: np.ndarray) -> dict[str, float]:
    """Root mean square error of specular albedo, and the same of the best constant.

    Args:
        found: (rows, columns).
        true: (rows, columns).
        skin: (rows, columns) bool, what is measured.
    """
    mine, theirs = found[skin].astype(float), true[skin].astype(float)
    return {
        "specular_rmse": float(np.sqrt(((mine - theirs) ** 2).mean())),
        "specular_constant_rmse": float(theirs.std()),
    }


def ssim(found: np.ndarray, true: np.ndarray, where: np.ndarray) -> float:
    """Mean structural similarity [Wang2004], of texels whose whole window counts.

    Args:
        found: (rows, columns, 3), 0..1.
        true: (rows, columns, 3), 0..1.
        where: (rows, columns) bool.

    Returns:
        The mean over texels and channels; NaN where no window is within `where`.
    """
    side = 2 * SSIM_REACH + 1
    whole = np.ones((side, side), np.uint8)
    kept = cv2.erode(where.astype(np.uint8), whole, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    inside = kept > 0
    if not inside.any():
        return float("nan")

    def mean(image: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(image, (side, side), SSIM_SIGMA)

    a, b = (np.where(where[..., None], x, 0).astype(float) for x in (found, true))
    mean_a, mean_b = mean(a), mean(b)
    var_a, var_b = mean(a * a) - mean_a**2, mean(b * b) - mean_b**2
    both = mean(a * b) - mean_a * mean_b
    value = (2 * mean_a * mean_b + SSIM_C1) * (2 * both + SSIM_C2)
    value /= (mean_a**2 + mean_b**2 + SSIM_C1) * (var_a + var_b + SSIM_C2)
    return float(value[inside].mean())
