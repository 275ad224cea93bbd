"""Two processed folders byte for byte, but for what a run took; who holds a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

TAKEN = ("seconds", "peak_rss_mb", "frames_kept_from_the_last_run")
"""Facts of what a run took, and what it found there."""
PAGE = "report.html"
"""Shows the facts of report.json, so it differs where they do."""


def differences(one: Path, other: Path) -> list[str]:
    """Names of files that only one folder has, or whose bytes differ but for `TAKEN`."""
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
    return [_without(each) for each in value] if isinstance(value, list) else value


def holder(lock: Path) -> int | None:
    """The process that holds a lock file; None where none does."""
    if not lock.exists():
        return None
    inode = lock.stat().st_ino
    for line in Path("/proc/locks").read_text().splitlines():
        words = line.split()
        if words[1] == "FLOCK" and words[5].endswith(f":{inode}"):
            return int(words[4])
    return None
