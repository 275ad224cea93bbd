"""Dark things beside a brighter one: a black collar, dark hair, the frame of glasses.

Cloth that reflects two per cent of the light is darker than the share of the face's brightness
that counts as foreground, and still many times as bright as the room behind it. It casts shadows
like any other cloth. So what is clearly brighter than the background is foreground too, where it
touches the bright region and ends in an edge; light that a lens scatters around a face fades out.
"""

from __future__ import annotations

import cv2
import numpy as np

DARKEST = 1 / 6
"""What is darker than this share of the foreground's threshold is never foreground."""
SIGMAS = 6.0
"""So many standard deviations above its mean the background ends."""
LOW, LOWER = 10.0, 1.0
"""Percentiles of the pixels beside the bright region; a tenth of them at least is background."""
LOW_SIGMAS, LOWER_SIGMAS = -1.28, -2.33
"""Where these percentiles of a normal distribution are."""
REACH_SHARE = 0.01
"""Share of the picture's height: narrower things are edges of the bright region, and regions that
are nearer to it touch it."""
LEAST_SHARE = 0.005
"""Share of the picture; smaller regions are not foreground."""
EDGE = 2.0
"""Inside its edge a region is so many times as bright as outside, above the background."""


def dim_regions(smooth: np.ndarray, bright: np.ndarray, threshold: float) -> np.ndarray:
    """Regions beside a bright one that are dark, and yet no background.

    Args:
        smooth: (h, w) float32 brightness, without single noisy pixels.
        bright: (h, w) bool, the bright region.
        threshold: brightness from which pixels are foreground anyway.

    Returns:
        (h, w) bool, outside of `bright`.
    """
    nothing = np.zeros(bright.shape, bool)
    rest = smooth[~bright & np.isfinite(smooth)]
    if not len(rest) or not bright.any():
        return nothing
    dark, sigma = background(rest)
    least = max(DARKEST * threshold, dark + SIGMAS * sigma)
    if not least < threshold:
        return nothing
    reach = max(1, round(REACH_SHARE * len(bright)))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    above = ((smooth > least) & ~bright).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        cv2.morphologyEx(above, cv2.MORPH_OPEN, kernel)
    )
    near = cv2.dilate(bright.astype(np.uint8), kernel) > 0
    empty = (above == 0) & ~bright
    out = nothing
    for label in range(1, count):
        if stats[label, cv2.CC_STAT_AREA] < LEAST_SHARE * bright.size:
            continue
        region = labels == label
        if (region & near).any() and _ends_in_an_edge(smooth - dark, region, empty, kernel):
            out = out | region
    return out


def background(rest: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation of a background, from pixels of which some are something else.

    Args:
        rest: (n,) brightness; the darkest tenth at least is background.
    """
    low, lower = np.percentile(rest, [LOW, LOWER])
    sigma = (low - lower) / (LOW_SIGMAS - LOWER_SIGMAS)
    return float(low - LOW_SIGMAS * sigma), float(sigma)


def _ends_in_an_edge(
    above: np.ndarray, region: np.ndarray, empty: np.ndarray, kernel: np.ndarray
) -> bool:
    """Whether a region is brighter by far, where it meets the background, than what is there.

    Args:
        above: (h, w) brightness above the background's.
        region: (h, w) bool.
        empty: (h, w) bool, background.
        kernel: how far from its edge it is compared.
    """
    beside = cv2.dilate(region.astype(np.uint8), kernel) > 0
    outside = beside & empty
    inside = region & (cv2.dilate(outside.astype(np.uint8), kernel) > 0)
    if not inside.any():
        return True  # It meets no background: foreground is all around it.
    return bool(np.median(above[inside]) > EDGE * max(float(np.median(above[outside])), 0.0))
