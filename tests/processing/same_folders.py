"""Two processed folders byte for byte, but for what a run took: seconds, memory, what it found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

TAKEN = ("seconds", "peak_rss_mb", "frames_kept_from_the_last_run")
PAGE = "report.html"
"""Shows the facts of report.json, so it differs where they do."""


def differences(one: Path, other: Path) -> list[str]:
    """Names of files that only one folder has, or whose bytes differ."""
    names = [
        {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}
        for root in (one, other)
    ]
    found = sorted(names[0] ^ names[1])
    for name in sorted(names[0] & names[1]):
        first, second = (one / name).read_bytes(), (other / name).read_bytes()
        if first == second or name == PAGE:
            continue
        if name.endswith(".json") and _without(json.loads(first)) == _without(json.loads(second)):
            continue
        found.append(name)
    return found


def _without(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without(each) for key, each in value.items() if key not in TAKEN}
    if isinstance(value, list):
        return [_without(each) for each in value]
    return value
