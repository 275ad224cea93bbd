"""Faults of photographs that the operator saw and accepted: they are in the session's record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lightstage.session.events import Line

Accepted = dict[str, list[dict[str, Any]]]
"""By pattern, the findings as the journal has them."""


_Key = tuple[str, str | None, str]
_Held = dict[str, dict[_Key, dict[str, Any]]]


def accepted_findings(lines: Sequence[Line]) -> Accepted:
    """What was accepted and still holds: not where the photograph was taken again later.

    Args:
        lines: of a journal.
    """
    held: _Held = {}
    for line in lines:
        if line["event"] == "accepted":
            for finding in line["findings"]:
                pattern = finding.get("pattern") or line["pattern"]
                held.setdefault(pattern, {})[_key(finding)] = finding
        elif line["event"] == "rejected":
            _forget(held, line["pattern"], line["camera"])
        elif line["event"] == "retake":
            for pattern, camera, _ in line["takes"]:
                _forget(held, pattern, camera)
    return {pattern: list(found.values()) for pattern, found in held.items() if found}


def _key(finding: dict[str, Any]) -> _Key:
    """What makes it another one: code, camera, place."""
    return finding["code"], finding.get("camera"), str(finding.get("where", ""))


def _forget(held: _Held, pattern: str, camera: str) -> None:
    """A photograph does not count any more, and findings on it do not hold."""
    mine = held.get(pattern, {})
    for key in [key for key in mine if key[1] in (None, camera)]:
        del mine[key]
