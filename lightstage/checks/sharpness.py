"""Focus: how much finer detail a photograph has than the same camera's others.

A lens out of focus takes away differences between close pixels and leaves those between far ones.
Their ratio in a cell hardly changes with the light, which scales both; so photographs of different
patterns can be compared, where both light the subject alike: not where one's light ends within a
cell, for a shadow's edge is no detail, and not where fine detail as strong as the other photograph
shows would drown in the noise. What is compared must be `MIN_PIXELS` large at least; a smaller
photograph shows nothing about focus. Blur that all of a camera's photographs share is found only
by its ratio to other cameras and to an earlier session.
"""

from __future__ import annotations

import cv2
import numpy as np

from lightstage.checks.noise import DIFFERENCE_GAIN
from lightstage.checks.photo_measures import LIT_SHARE, Photo, pool_size

MIN_CELLS = 6
MIN_PIXELS = 2_000
"""Pixels of the photograph in all cells that are compared, at least."""
NOISE_FACTOR = 3.0
"""Far detail must be this many times the noise of a pixel to count."""
FINE_NOISE = 1.0
"""Near detail must be this many times what noise adds to it: what is left of the noise, when it has
been taken away, is a tenth of it at most."""
LIGHT_STEP = 2.5
"""Factor by which the light's share may differ among a cell and its neighbours."""
SURE = 3.0
"""Standard errors that a ratio must be from 1."""


def fineness(photo: Photo) -> np.ndarray:
    """(r, c) near over far differences squared; NaN where there is no detail, light or room."""
    near, far = photo.detail[..., 0].astype(float), photo.detail[..., 1].astype(float)
    green = photo.coarse[..., 1]
    good = (green > LIT_SHARE * photo.signal) & photo.usable
    good &= far > NOISE_FACTOR * pixel_noise(photo)
    good &= far > 1e-6 * np.maximum(green, 1e-9) ** 2
    return np.where(good, np.maximum(near, 0.0) / np.where(good, far, 1.0), np.nan)


def pixel_noise(photo: Photo) -> np.ndarray:
    """(r, c) variance of a green pixel by noise, share of white squared."""
    green = np.maximum(photo.coarse[..., 1], 0.0)
    return np.asarray(photo.noise[0] + photo.noise[1] * green, float)


def sharpness(photo: Photo, reference: Photo) -> float | None:
    """Fine detail of a photograph against another of the same camera: 1 is alike.

    Returns:
        The median over cells of the ratio of `fineness`, as a ratio of lengths (its root); None
        where too little of the subject is lit alike, with detail above the noise, in both, or the
        cells disagree so that nothing is sure.
    """
    if photo.detail.shape != reference.detail.shape:
        return None
    ours, theirs = fineness(photo), fineness(reference)
    both = np.isfinite(ours) & np.isfinite(theirs) & (theirs > 0)
    both &= _lit_alike(photo, reference) & _above_noise(photo, reference)
    if not _enough(both, photo):
        return None
    ratios = ours[both] / theirs[both]
    ratio = float(np.median(ratios))
    low, high = np.quantile(ratios, (0.25, 0.75))
    error = 1.25 * float(high - low) / 1.35 / np.sqrt(both.sum())
    sure = abs(ratio - 1.0) > SURE * error
    return float(np.sqrt(ratio)) if sure else 1.0


def own_sharpness(photo: Photo) -> float | None:
    """The root of the median fineness of a photograph alone; None where there is no detail."""
    ours = fineness(photo)
    if np.isfinite(ours).sum() < MIN_CELLS:
        return None
    return float(np.sqrt(np.nanmedian(ours)))


def _enough(cells: np.ndarray, photo: Photo) -> bool:
    side = photo.cell_px * pool_size(photo.light.shape[:2])
    count = int(cells.sum())
    return count >= MIN_CELLS and count * side**2 >= MIN_PIXELS


def _lit_alike(photo: Photo, reference: Photo) -> np.ndarray:
    """(r, c) bool, cells in which one light is the same share of the other as all around."""
    greens = [p.coarse[..., 1].astype(np.float32) for p in (photo, reference)]
    floors = [max(LIT_SHARE * p.signal, 1e-9) for p in (photo, reference)]
    # Where neither lights the subject is background, which has no share.
    lit = (greens[0] > floors[0]) | (greens[1] > floors[1])
    ours, theirs = (np.maximum(g, f / 10) for g, f in zip(greens, floors, strict=True))
    share = np.log(ours / theirs).astype(np.float32)
    window, none = np.ones((3, 3), np.uint8), np.float32(1e3)
    highest = cv2.dilate(np.where(lit, share, -none), window)
    lowest = cv2.erode(np.where(lit, share, none), window)
    return np.asarray(lit & (highest - lowest < np.log(LIGHT_STEP)))


def _above_noise(photo: Photo, reference: Photo) -> np.ndarray:
    """(r, c) bool, cells where the finer of both, in either one's light, is above its noise."""
    # Of a quad's mean of two greens; where only one is green the noise is twice this.
    noise = [DIFFERENCE_GAIN / 2 * pixel_noise(p) for p in (photo, reference)]
    light = [np.maximum(p.coarse[..., 1].astype(float), 1e-12) ** 2 for p in (photo, reference)]
    fine = np.maximum(photo.detail[..., 0] / light[0], reference.detail[..., 0] / light[1])
    return np.asarray(
        (fine * light[0] > FINE_NOISE * noise[0]) & (fine * light[1] > FINE_NOISE * noise[1])
    )
