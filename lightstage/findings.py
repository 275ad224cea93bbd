"""What a check of a device or a photograph found: in plain words, with what to do."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

from lightstage.counting import counted

Severity = Literal["refuse", "retake", "warn", "note"]
"""``refuse``: no light goes on; ``retake``: this photograph or pattern is not usable; ``warn``: the
operator should know; ``note``: for the record."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing found.

    Attributes:
        severity: what follows from it.
        code: its kind, such as ``clipped``, for programs.
        where: device or photograph, as in errors.
        found: what is so.
        expected: what should be.
        hint: what to do.
        pattern: whose light, where it is a matter of one.
        camera: whose photograph or settings, where it is a matter of one.
        suspects: other patterns whose photographs by the same camera take part in a contradiction,
            and may be the wrong ones instead of `pattern`'s.
    """

    severity: Severity
    code: str
    where: str
    found: str
    expected: str
    hint: str = ""
    pattern: str | None = None
    camera: str | None = None
    suspects: tuple[str, ...] = ()

    def __str__(self) -> str:
        text = f"{self.where}: found {self.found}, expected {self.expected}"
        return f"{text}. {self.hint}" if self.hint else text


def accepted_in_words(patterns: int, findings: int) -> str:
    """How many patterns the operator accepted with faults; empty where there are none."""
    if not patterns:
        return ""
    by = "accepted by the operator with"
    return f"{counted(patterns, 'pattern')} {by} {counted(findings, 'finding')}"


MOST_DIGITS = 6


def two_digits(value: float, limit: float | None = None) -> str:
    """A number of two significant digits in plain figures, from 100 on all of its whole ones.

    Args:
        value: the number.
        limit: what it misses: it has more digits where two would make it this.
    """
    if not math.isfinite(value):
        return str(value)
    if abs(value) >= 100:
        return f"{value:.0f}"
    digits = 2
    while limit is not None and digits < MOST_DIGITS and float(f"{value:.{digits}g}") == limit:
        digits += 1
    text = f"{float(f'{value:.{digits}g}'):.9f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text
