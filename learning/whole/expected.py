"""The error expected of a refined albedo: what refinement left open, and what it changed."""

from __future__ import annotations

import numpy as np

from learning.encoding import srgb_from_linear
from learning.maps import from_batch, to_batch
from learning.whole.detail import enlarged

ENCODED_PER_LOG = 0.5
"""Error of the sRGB-encoded albedo for a standard deviation of its natural logarithm. This and
`GAP_ERROR` are least squares over three simulated people and three of ICT's under ten lights
each, none of whom the benchmark has."""
GAP_ERROR = 0.037
"""The same error where the texture did not show the skin."""


def log_deviation(modes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n,) standard deviation of the albedo's logarithm, mean of the channels.

    Args:
        modes: (n, 3, K) directions in which people differ.
        covariance: (K, K) of a person along them.
    """
    mean = modes.mean(axis=1)
    return np.sqrt(np.maximum(np.einsum("nk,kl,nl->n", mean, covariance, mean), 0.0))


def expected_error(
    albedo: np.ndarray, answer_log: np.ndarray, deviation_log: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """The error that is expected of the sRGB-encoded albedo at each texel.

    Refinement and the network are two estimates of one skin: where they differ one of them is
    wrong. What the texture's light leaves open of the person's skin is wrong everywhere at once,
    and what the texture does not show is guessed.

    Args:
        albedo: (rows, columns, 3) linear, refined.
        answer_log: (h, w, 3) natural logarithm of the network's own.
        deviation_log: (h, w) standard deviation of the skin's logarithm, see `log_deviation`.
        known: (rows, columns) bool, where the texture shows the skin.

    Returns:
        (rows, columns) float32.
    """
    rows, columns = known.shape
    answer = np.exp(enlarged(answer_log.astype(np.float32), rows, columns))
    apart = np.abs(_encoded(albedo) - _encoded(answer)).mean(axis=2)
    left_open = ENCODED_PER_LOG * enlarged(deviation_log.astype(np.float32), rows, columns)
    squared = left_open**2 + apart**2 + np.where(known, 0.0, GAP_ERROR**2)
    return np.sqrt(squared).astype(np.float32)


def _encoded(rgb_linear: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) sRGB of linear values."""
    return from_batch(srgb_from_linear(to_batch(rgb_linear.astype(np.float32))))
