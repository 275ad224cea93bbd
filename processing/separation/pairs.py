"""Complementary pairs of gradients along x, y and z among a session's patterns."""

from __future__ import annotations

import numpy as np

from processing.errors import ProcessingError


def axis_pairs(patterns: tuple[str, ...]) -> np.ndarray:
    """Indices of x+ x-, y+ y-, z+ z- among patterns.

    Args:
        patterns: names.

    Returns:
        (3, 2) int64.

    Raises:
        ProcessingError: one of the six is missing.
    """
    wanted = [[f"{axis}{sign}" for sign in "+-"] for axis in "xyz"]
    missing = [name for pair in wanted for name in pair if name not in patterns]
    if missing:
        raise ProcessingError(
            "session.json",
            field="sequence",
            found=f"no {', '.join(missing)} among {', '.join(patterns)}",
            expected="gradients along x, y and z, each with its complement",
            hint="Capture with `--sequence binary`.",
        )
    return np.array([[patterns.index(name) for name in pair] for pair in wanted], np.int64)


def full_reading(rgb: np.ndarray, patterns: tuple[str, ...], pairs: np.ndarray) -> np.ndarray:
    """(n, 3) what pixels read under `full`, or where it was not shot, the mean sum of the pairs.

    Args:
        rgb: (n, P, 3).
        patterns: P names.
        pairs: (3, 2) of `axis_pairs`.
    """
    if "full" in patterns:
        return np.asarray(rgb[:, patterns.index("full")])
    return np.asarray(rgb[:, pairs.ravel()].sum(axis=1) / len(pairs))
