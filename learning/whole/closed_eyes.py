"""Closed eyes in a texture, which mislead the network: it takes lids for the whites of eyes.

The whites of open eyes show the network how strong the light is, since they are alike on all
people. They are less red than the skin around them, in light of any colour. Where they are not,
the eyes are closed, painted or covered, and the skin beside what seems to be a white would look
far too light.
"""

from __future__ import annotations

import numpy as np

from learning.masks import widened

LESS_RED = 0.3
"""Logarithm of red over blue, below the face's median, from which the mean person shows a white."""
FEWEST_TEXELS = 8
"""Of whites and of skin around them, at the network's size, below which nothing is known."""
LEAST_CONTRAST = 0.2
"""Logarithm by which the skin around open eyes is redder at least: our people's .26 to .73, ICT's
.36 to .73 but for one with 0 to .16; the closed lids of the scanned head -.11 to .13."""
CLOSE, AROUND = 1, 3
"""Texels around a white that may show it in part, and those that show the skin beside it."""
LID = 2
"""Texels around a white that an eye covers."""
DARKEST = 1e-9
"""Light below it counts as so much, since zero has no logarithm."""


def eyes_of(mean_log_albedo: np.ndarray, face: np.ndarray) -> np.ndarray:
    """(h, w) bool, texels that are not shown where eyes are closed; arguments of `closed_eyes`."""
    return widened(_whites(mean_log_albedo, face), LID)


def closed_eyes(
    texture: np.ndarray, seen: np.ndarray, mean_log_albedo: np.ndarray, face: np.ndarray
) -> np.ndarray:
    """(h, w) bool, texels of eyes where these are not open; none where that is not known.

    Args:
        texture: (h, w, 3) linear, at the network's size.
        seen: (h, w) bool.
        mean_log_albedo: (h, w, 3) natural logarithm, of the mean person.
        face: (h, w) bool, where brows, eyes and lips are.
    """
    none = np.zeros_like(seen)
    whites = _whites(mean_log_albedo, face)
    beside = widened(whites, AROUND) & ~widened(whites, CLOSE) & seen
    shown = whites & seen
    if min(shown.sum(), beside.sum()) < FEWEST_TEXELS:
        return none
    light = np.log(np.maximum(np.nan_to_num(texture), DARKEST))
    red = light[..., 0] - light[..., 2]
    if red[beside].mean() - red[shown].mean() >= LEAST_CONTRAST:
        return none
    return widened(whites, LID)


def _whites(mean_log_albedo: np.ndarray, face: np.ndarray) -> np.ndarray:
    """(h, w) bool, whites of the mean person's eyes."""
    if not face.any():
        return np.zeros_like(face)
    red = mean_log_albedo[..., 0] - mean_log_albedo[..., 2]
    found: np.ndarray = face & (red < np.median(red[face]) - LESS_RED)
    return found
