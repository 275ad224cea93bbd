"""Skin that a texture does not show: from the texels around, and from the face's other side.

A texture over its light shows nothing at the edges of shadows, in the dark and in highlights. Left
to the skin that people have in common, these places show as blots. Neighbours continue into them
without a step, and what is seen on one side of a face is, in part, on the other side too.
"""

from __future__ import annotations

import cv2
import numpy as np

from learning.whole.detail import blurred

FEWEST_TEXELS = 100
"""Texels known on both sides, below which a face does not show how alike its sides are."""
ALIKE = 0.5
"""How alike sides then are taken to be: our people's, ICT's and the scanned head's have 0.35 to
0.63."""
ALIKE_SHARES = 1 / 384, 1 / 48
"""Standard deviations, of a texture's rows, between which the likeness is measured."""
LEAST_SHARE = 1e-9
"""Known share of the largest texel, against division by zero."""
MOST_BESIDE = 0.5
"""Logarithm at which a texel's part in that measure is cut."""


def without_gaps(
    beside: np.ndarray, known: np.ndarray, covered: np.ndarray, sides: bool
) -> np.ndarray:
    """Fill what is not known.

    Args:
        beside: (rows, columns, 3) what a skin is beside the one that people have in common, natural
            logarithm.
        known: (rows, columns) bool, where `beside` is known.
        covered: (rows, columns) bool, where a surface is.
        sides: whether the texture's columns, in reverse, are the face's other side.

    Returns:
        (rows, columns, 3) float32: `beside` where it is known, finite everywhere, 0 without
        surface or where nothing is known.
    """
    seen = known & covered
    own = np.where(seen[..., None], beside, 0).astype(np.float32)
    found = continued(own, seen)
    other, there = own[:, ::-1], seen[:, ::-1]
    if sides and (there & ~seen).any():
        both = seen & there
        share = likeness(own, other, both)
        step = continued((own - share * other) * both[..., None], both)
        found = np.where((there & ~seen)[..., None], share * other + step, found)
    return np.where(seen[..., None], own, found) * covered[..., None]


def likeness(own: np.ndarray, other: np.ndarray, both: np.ndarray) -> float:
    """How much of what one side shows the other shows too, 0..1, by least squares.

    Args:
        own: (rows, columns, 3) of one side.
        other: (rows, columns, 3) of the other, mirrored.
        both: (rows, columns) bool, where both are known.
    """
    if both.sum() < FEWEST_TEXELS:
        return ALIKE
    rows = len(own)
    finest, widest = (share * rows for share in ALIKE_SHARES)
    weight = both.astype(np.float32)
    around = np.maximum(blurred(weight, widest), 1e-3)[..., None]

    def marks(image: np.ndarray) -> np.ndarray:
        known = image * weight[..., None]
        fine = (known - blurred(known, widest) / around) * weight[..., None]
        return np.clip(blurred(fine, finest)[both], -MOST_BESIDE, MOST_BESIDE)

    one, two = marks(own), marks(other)
    return float(np.clip((one * two).sum() / max(float((two * two).sum()), 1e-9), 0, 1))


def continued(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Continue an image from where it is known, smoothly, through ever larger texels.

    Args:
        image: (rows, columns, c) float32, 0 where it is not known.
        known: (rows, columns) bool.

    Returns:
        (rows, columns, c): the image where it is known; zeros where nothing is.
    """
    totals: list[np.ndarray] = [image]
    shares: list[np.ndarray] = [known.astype(np.float32)]
    while max(shares[-1].shape) > 1:
        size = tuple((side + 1) // 2 for side in shares[-1].shape[::-1])
        for levels in (totals, shares):
            levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA))
    found = totals[-1] / np.maximum(shares[-1], LEAST_SHARE)[..., None]
    for total, share in zip(totals[-2::-1], shares[-2::-1], strict=True):
        around = cv2.resize(found, share.shape[::-1], interpolation=cv2.INTER_LINEAR)
        # Where a texel is known in part, that part counts, and the larger texels' for the rest.
        found = total + (1 - share)[..., None] * around.reshape(total.shape)
    return found
