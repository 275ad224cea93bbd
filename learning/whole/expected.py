"""The error expected of an albedo: what the network expects, and what refinement changed."""

from __future__ import annotations

import numpy as np

from learning.encoding import srgb_from_linear
from learning.maps import from_batch, to_batch
from learning.whole.detail import enlarged

MARGIN = 1.3
"""Factor of the root of the sum of squares, by which all kinds of heads count alike: errors are .8
times that root on twelve simulated people under ten lights, 1.2 times on twelve of ICT's, 2.4 times
on a scanned head. Of these people the scanned head alone is in a benchmark."""
GAP_ERROR = 0.02
"""Expected beside it where the texture did not show the skin."""


def expected_error(own: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The error that is expected of a network's sRGB-encoded albedo at each texel.

    Args:
        own: (h, w) error that the network expects of its own.
        shape: rows and columns of the answer.

    Returns:
        (rows, columns) float32.
    """
    return enlarged((MARGIN * own).astype(np.float32), *shape)


def expected_of_refined(
    error: np.ndarray, albedo: np.ndarray, answer_log: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """The error that is expected of a refined albedo.

    Refinement and the network are two estimates of one skin: where they differ one of them is
    wrong. What the texture does not show is guessed. What refinement's own equations leave open of
    a person's tone is no part of it: it is as large on textures whose tone is found well.

    Args:
        error: (rows, columns) of `expected_error`.
        albedo: (rows, columns, 3) linear, refined.
        answer_log: (h, w, 3) natural logarithm of the network's own.
        known: (rows, columns) bool, where the texture shows the skin.

    Returns:
        (rows, columns) float32.
    """
    answer = np.exp(enlarged(answer_log.astype(np.float32), *known.shape))
    apart = np.abs(_encoded(albedo) - _encoded(answer)).mean(axis=2)
    squared = error**2 + MARGIN**2 * (apart**2 + np.where(known, 0.0, GAP_ERROR**2))
    return np.sqrt(squared).astype(np.float32)


def _encoded(rgb_linear: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) sRGB of linear values."""
    return from_batch(srgb_from_linear(to_batch(rgb_linear.astype(np.float32))))
