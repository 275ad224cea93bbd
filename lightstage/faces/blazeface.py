"""Where faces are: a single-shot detector on a small copy of the picture [Bazarevsky2019].

For every anchor, a place of a coarse grid, the network gives a score, a square beside the anchor
and six points, of which the eyes turn the crop. Squares of one face that overlap are not thrown
away but averaged by their scores, which keeps a face from trembling [Bazarevsky2019, section 4].
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from lightstage.faces.weights import DETECTION, outputs_of

SIZE_PX = 256
GRIDS = ((16, 2), (8, 6))
"""Cells a side of each grid of anchors, and anchors at the centre of each cell."""
POINTS = 6
"""Right eye, left eye (the person's), tip of the nose, mouth, right ear, left ear."""


class Found(NamedTuple):
    """What may be a face.

    Attributes:
        score: 0..1.
        centre_px: (2,).
        size_px: side of the square.
        points_px: (6, 2).
    """

    score: float
    centre_px: np.ndarray
    size_px: float
    points_px: np.ndarray


@functools.cache
def anchors() -> np.ndarray:
    """(896, 2) x and y of the anchors as shares of the picture, in the network's order."""
    grids = []
    for cells, each in GRIDS:
        y, x = np.mgrid[:cells, :cells]
        centres = (np.stack([x, y], axis=2).reshape(-1, 2) + 0.5) / cells
        grids.append(np.repeat(centres, each, axis=0))
    return np.concatenate(grids)


def find(image_srgb: np.ndarray, least_score: float, overlap: float) -> list[Found]:
    """Find what may be faces.

    Args:
        image_srgb: (h, w, 3) uint8 of any size.
        least_score: 0..1.
        overlap: squares whose intersection is more than this share of their union are one face.

    Returns:
        Best first, in the picture's own pixels.
    """
    copy, factor, corner = _letterboxed(image_srgb)
    names = ("classificators", "regressors")
    scores, values = outputs_of(DETECTION, copy.astype(np.float32) / 127.5 - 1, names)
    score = 1 / (1 + np.exp(-np.clip(scores, -80, 80)))
    likely = np.flatnonzero(score >= least_score)
    values = values.reshape(-1, 4 + 2 * POINTS)[likely]
    origin = SIZE_PX * anchors()[likely]
    centre, side = values[:, :2] + origin, values[:, 2:4].max(axis=1)
    points = values[:, 4:].reshape(-1, POINTS, 2) + origin[:, None]
    return [
        Found(f.score, (f.centre_px - corner) / factor, f.size_px / factor, inside)
        for f in blended(score[likely], centre, side, points, overlap)
        for inside in [(f.points_px - corner) / factor]
    ]


def _letterboxed(image: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """The picture as a square of the network's size, black beside it, and where it is there."""
    import cv2

    height, width = image.shape[:2]
    factor = SIZE_PX / max(height, width)
    small = (max(1, round(width * factor)), max(1, round(height * factor)))
    kind = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    x, y = (SIZE_PX - small[0]) // 2, (SIZE_PX - small[1]) // 2
    copy = np.zeros((SIZE_PX, SIZE_PX, 3), np.uint8)
    copy[y : y + small[1], x : x + small[0]] = cv2.resize(image, small, interpolation=kind)
    return copy, factor, np.array([x, y], float)


def blended(
    score: np.ndarray, centre: np.ndarray, side: np.ndarray, points: np.ndarray, overlap: float
) -> list[Found]:
    """One face for each heap of squares that overlap: their mean, weighted by the scores.

    Args:
        score: (n,) positive.
        centre: (n, 2).
        side: (n,) sides of the squares; those that are not positive and finite are left out.
        points: (n, 6, 2).
        overlap: as `find`.

    Returns:
        Best first; a heap's score is its best square's.
    """
    sound = np.isfinite(centre).all(axis=1) & np.isfinite(side) & (side > 0)
    sound &= np.isfinite(points).all(axis=(1, 2))
    left = np.flatnonzero(sound)
    left = left[np.argsort(-score[left], kind="stable")]
    out = []
    while len(left):
        alike = shared(centre[left[0]], side[left[0]], centre[left], side[left]) > overlap
        alike[0] = True
        heap = left[alike]
        weight = score[heap] / score[heap].sum()
        out.append(
            Found(
                float(score[heap[0]]),
                weight @ centre[heap],
                float(weight @ side[heap]),
                np.einsum("n,nij->ij", weight, points[heap]),
            )
        )
        left = left[~alike]
    return out


def shared(centre: np.ndarray, side: float, centres: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(n,) intersection over union of one square with n others."""
    low = np.maximum(centre - side / 2, centres - sides[:, None] / 2)
    high = np.minimum(centre + side / 2, centres + sides[:, None] / 2)
    both = np.clip(high - low, 0, None).prod(axis=1)
    either = side**2 + sides**2 - both
    return np.divide(both, either, out=np.zeros_like(either), where=either > 0)
