"""The error expected of an albedo: what is not known of the skin, and what refinement changed."""

from __future__ import annotations

import numpy as np

from learning.encoding import srgb_from_linear
from learning.maps import from_batch, to_batch
from learning.networks.whole_face import WholeFaceNetwork
from learning.whole.detail import enlarged

ENCODED_PER_LOG = 0.5
"""Error of the sRGB-encoded albedo for a standard deviation of its natural logarithm. This and
`GAP_ERROR` are least squares over three simulated people and three of ICT's under ten lights
each, none of whom the benchmark has."""
OWN_SHARE = 0.5
"""Of the square of the error that the network expects of a place. Least squares gave 0 on these
heads; the scanned head needs it, and 1 is too much for the others."""
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


def doubt_of(network: WholeFaceNetwork) -> np.ndarray:
    """(h, w) standard deviation of the logarithm of a network's albedo, by its doubt of the person.

    The doubt is the network's mean square error along the directions in which people differ, on
    people held out of its training.
    """
    modes = network.albedo_modes.permute(2, 3, 1, 0).numpy().astype(float)
    modes = modes * network.mode_deviations.numpy()
    rows, columns, _, count = modes.shape
    found = log_deviation(modes.reshape(-1, 3, count), network.mode_doubt.numpy().astype(float))
    return found.reshape(rows, columns)


def expected_error(
    deviation_log: np.ndarray, own: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """The error that is expected of a network's sRGB-encoded albedo at each texel.

    What is not known of the person's skin is wrong everywhere at once; beside it is what the
    network expects of each place.

    Args:
        deviation_log: (h, w) standard deviation of the skin's logarithm.
        own: (h, w) error that the network expects.
        shape: rows and columns of the answer.

    Returns:
        (rows, columns) float32.
    """
    squared = (ENCODED_PER_LOG * deviation_log) ** 2 + OWN_SHARE * own**2
    return enlarged(np.sqrt(squared).astype(np.float32), *shape)


def expected_of_refined(
    error: np.ndarray, albedo: np.ndarray, answer_log: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """The error that is expected of a refined albedo.

    Refinement and the network are two estimates of one skin: where they differ one of them is
    wrong. What the texture does not show is guessed.

    Args:
        error: (rows, columns) of `expected_error`, by what refinement left open of the skin.
        albedo: (rows, columns, 3) linear, refined.
        answer_log: (h, w, 3) natural logarithm of the network's own.
        known: (rows, columns) bool, where the texture shows the skin.

    Returns:
        (rows, columns) float32.
    """
    answer = np.exp(enlarged(answer_log.astype(np.float32), *known.shape))
    apart = np.abs(_encoded(albedo) - _encoded(answer)).mean(axis=2)
    squared = error**2 + apart**2 + np.where(known, 0.0, GAP_ERROR**2)
    return np.sqrt(squared).astype(np.float32)


def _encoded(rgb_linear: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) sRGB of linear values."""
    return from_batch(srgb_from_linear(to_batch(rgb_linear.astype(np.float32))))
