"""Patterns whose light must add up alike, and the fault where their photographs do not.

Light is linear: a gradient and its complement sum to `full`, and without `full` the pairs of all
axes sum to the same. `lightstage check` and the stage `decode` hold photographs to it, by the same
limit and in the same words.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.patterns.names import complement

SUM_TOLERANCE = 0.1
"""Sums that must be equal are, in every camera's mean, up to this share."""
LEVEL_STEP = 1e-3
"""Levels are compared to this; devices round to steps of their own."""
SLACK = 1.5
"""Steps by which rounding may part two sums."""
UNLIKE, UNLIKE_RATIO = 0.2, 1.5
"""A photograph shows another pattern when it is this far from its own and this many times nearer
to the other."""
UNCHECKED = (
    "no photographs add up to the same light (a gradient, its complement and full, or two axes): "
    "whether each shows its own pattern could not be checked"
)


@dataclasses.dataclass(frozen=True)
class Balance:
    """Two sets of patterns whose levels have the same sum."""

    left: tuple[str, ...]
    right: tuple[str, ...]

    @property
    def patterns(self) -> tuple[str, ...]:
        """All of both."""
        return (*self.left, *self.right)


def axes_alike(levels: Mapping[str, np.ndarray]) -> list[Balance]:
    """Pairs of complements with the same sum, where no pattern alone has that sum.

    Args:
        levels: pattern to (n,) levels.

    Returns:
        For each group of pairs that sum alike all combinations of two.
    """
    pairs: list[tuple[tuple[str, str], np.ndarray]] = []
    for name in levels:
        other = complement(name)
        if other is None or other not in levels or name > other:
            continue
        total = np.asarray(levels[name], float) + np.asarray(levels[other], float)
        if not any(_alike(total, np.asarray(each, float)) for each in levels.values()):
            pairs.append(((name, other), total))
    return [
        Balance(first, second)
        for place, (first, total) in enumerate(pairs)
        for second, other_total in pairs[place + 1 :]
        if first[0].partition("@")[2] == second[0].partition("@")[2] and _alike(total, other_total)
    ]


def has_gradient(levels: Mapping[str, np.ndarray]) -> bool:
    """Whether any pattern, (n,) levels by name, is one whose light others should complete."""
    return any(complement(name) is not None for name in levels)


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.abs(one - other).max() <= SLACK * LEVEL_STEP)


def sum_fault(
    root: Path, camera: str, balance: Balance, left: float, right: float, hint: str = ""
) -> FormatError | None:
    """The error of photographs that do not add up as their levels do; None where they do.

    Args:
        root: of the session.
        camera: whose photographs.
        balance: which.
        left: sum of the means of `balance.left`, share of white.
        right: of `balance.right`; at least what counts as light.
        hint: further advice.
    """
    if abs(left - right) <= SUM_TOLERANCE * abs(right):
        return None
    shares = [
        f"{' + '.join(names)} = {value:.4g}"
        for names, value in ((balance.left, left), (balance.right, right))
    ]
    why = "Was a pattern not lit, or a photograph of another one?"
    return FormatError(
        root / "session.json",
        field=f"patterns of {camera}",
        found=f"{shares[0]} on average, {shares[1]}",
        expected=f"equal within {100 * SUM_TOLERANCE:g} %",
        hint=f"{why} {hint}".rstrip(),
    )
