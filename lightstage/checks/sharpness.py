"""Focus: how much finer detail a photograph has than the same camera's others.

A lens out of focus takes away differences between close pixels and leaves those between far ones.
Their ratio in a cell hardly changes with the light, which scales both; so photographs of different
patterns can be compared. Blur that all of a camera's photographs share is told by its ratio to
other cameras and to an earlier session only.
"""

from __future__ import annotations

import numpy as np

from lightstage.checks.photo import LIT_SHARE, Photo

MIN_CELLS = 6
NOISE_FACTOR = 3.0
"""Detail must be this many times the noise to count."""


def fineness(photo: Photo) -> np.ndarray:
    """(r, c) near over far differences squared; NaN where there is no detail, light or room."""
    near, far = photo.detail[..., 0].astype(float), photo.detail[..., 1].astype(float)
    green = photo.coarse[..., 1]
    noise = photo.noise[0] + photo.noise[1] * np.maximum(green, 0.0)
    good = (green > LIT_SHARE * photo.signal) & photo.usable
    good &= far > NOISE_FACTOR * noise
    good &= far > 1e-6 * np.maximum(green, 1e-9) ** 2
    return np.where(good, np.maximum(near, 0.0) / np.where(good, far, 1.0), np.nan)


def sharpness(photo: Photo, reference: Photo) -> float | None:
    """Fine detail of a photograph against another of the same camera: 1 is alike.

    Returns:
        The median over cells of the ratio of `fineness`, as a ratio of lengths (its root); None
        where too few cells have detail in both.
    """
    if photo.detail.shape != reference.detail.shape:
        return None
    ours, theirs = fineness(photo), fineness(reference)
    both = np.isfinite(ours) & np.isfinite(theirs) & (theirs > 0)
    if both.sum() < MIN_CELLS:
        return None
    return float(np.sqrt(np.median(ours[both] / theirs[both])))


def own_sharpness(photo: Photo) -> float | None:
    """The root of the median fineness of a photograph alone; None where there is no detail."""
    ours = fineness(photo)
    if np.isfinite(ours).sum() < MIN_CELLS:
        return None
    return float(np.sqrt(np.nanmedian(ours)))
