"""The linear model: principal modes of the anatomical fields, and expressions.

Heads are linear in the fields, so the principal components of independent unit draws follow exactly
from the fields' Gram matrix, with no sampling.
"""

from __future__ import annotations

import functools

import numpy as np

from sim.head.expressions import EXPRESSIONS, expression_modes
from sim.head.fields import identity_fields

__all__ = ["EXPRESSIONS", "IDENTITY_MODES", "expression_modes", "identity_fields", "identity_modes"]

IDENTITY_MODES = 10


@functools.cache
def identity_modes() -> np.ndarray:
    """(IDENTITY_MODES, n, 3) principal modes of the fields, mm at one standard deviation."""
    _, fields = identity_fields()
    flat = fields.reshape(len(fields), -1)
    _, vectors = np.linalg.eigh(flat @ flat.T)
    # With unit draws a, a . F = sum_i (a . w_i) (w_i . F): w_i . F is one deviation of mode i.
    modes = vectors[:, ::-1][:, :IDENTITY_MODES].T @ flat
    largest = np.abs(modes).argmax(axis=1)
    modes *= np.sign(modes[np.arange(len(modes)), largest])[:, None]
    modes = modes.reshape(IDENTITY_MODES, -1, 3)
    modes.flags.writeable = False
    return modes
