"""A template's own landmarks from a detected face, by where the 468 points are on the template.

Who marks landmarks decides what a brow's or a jaw's landmark is; the detector's points have
meanings of their own. Each landmark is therefore a mean of points near it, weighted so that on the
template itself it comes out where the template has it.
"""

from __future__ import annotations

import numpy as np

from lightstage.faces.detect import Face
from lightstage.faces.schemes import visible

NEIGHBOURS = 24
SMOOTH = 1.0
"""How much a point's distance costs: small follows the template closer and the detector's noise
more."""
MISSED_MM = 3.0
"""A landmark that its points miss by more on the template, such as the jaw's, is left out."""
SEEN_SHARE = 0.7
"""Share of a landmark's weights that must be those of visible points."""


def landmark_weights(points_mm: np.ndarray, landmarks_mm: np.ndarray) -> np.ndarray:
    """How much of each point each landmark is.

    The least squares of the miss, with weights that cost by their point's distance and sum to 1.

    Args:
        points_mm: (n, 3) the detector's points on the template, NaN where there is none.
        landmarks_mm: (m, 3) the template's landmarks.

    Returns:
        (m, n); rows of zeros for landmarks that cannot be computed.
    """
    weights = np.zeros((len(landmarks_mm), len(points_mm)))
    known = np.flatnonzero(np.isfinite(points_mm).all(axis=1))
    for index, place in enumerate(landmarks_mm):
        away = np.linalg.norm(points_mm[known] - place, axis=1)
        near = known[np.argsort(away)[:NEIGHBOURS]]
        if len(near) == 0:
            continue
        offset = points_mm[near] - place
        cost = SMOOTH * (1 + np.sum(offset**2, axis=1))
        share = np.linalg.solve(offset @ offset.T + np.diag(cost), np.ones(len(near)))
        share /= share.sum()
        if np.linalg.norm(share @ offset) <= MISSED_MM:
            weights[index, near] = share
    return weights


def template_landmarks(face: Face, weights: np.ndarray) -> np.ndarray:
    """A template's landmarks in a picture.

    Args:
        face: as detected.
        weights: (m, 468) of `landmark_weights`.

    Returns:
        (m, 2) pixels, NaN where the head hides a landmark or it cannot be computed.
    """
    seen = weights * visible(face)
    total = seen.sum(axis=1, keepdims=True)
    seen_enough = total[:, 0] >= SEEN_SHARE
    out = np.full((len(weights), 2), np.nan)
    out[seen_enough] = (seen[seen_enough] / total[seen_enough]) @ face.points_px
    return out
