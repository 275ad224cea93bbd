"""What was amiss in several takes of one pose, in one message."""

from __future__ import annotations

from collections.abc import Sequence

from lightstage.findings import Finding


def joined(takes: Sequence[Sequence[Finding]]) -> tuple[str, str, str]:
    """Join the findings of each take: what is found again is reported once, with its takes.

    Args:
        takes: findings of each take, in order; none of them empty.

    Returns:
        What was found, what was expected, and what to do, each in one text.
    """
    where: dict[str, dict[str, list[int]]] = {}
    expected: dict[str, None] = {}
    hints: dict[str, None] = {}
    for number, findings in enumerate(takes, 1):
        for finding in findings:
            place = finding.camera or "all cameras"
            where.setdefault(place, {}).setdefault(finding.found, []).append(number)
            expected.setdefault(finding.expected)
            hints.setdefault(finding.hint)
    parts = [
        f"{place}: "
        + ", ".join(found + _in_takes(numbers, len(takes)) for found, numbers in each.items())
        for place, each in where.items()
    ]
    return "; ".join(parts), "; ".join(expected), " ".join(filter(None, hints))


def _in_takes(numbers: Sequence[int], count: int) -> str:
    """Which takes it was; empty where it was every one of them."""
    if len(numbers) == count:
        return ""
    if len(numbers) == 1:
        return f" (take {numbers[0]})"
    return f" (takes {', '.join(str(number) for number in numbers)})"
