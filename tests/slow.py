"""Which files of tests are slow: `slow.txt`, written from a run's own times.

A file is marked whole, not its slowest test: what a test is slow for, a scene or a network that
many share, the next one of the file would make in its place.

    python -m pytest --junit-xml build/junit.xml
    python -m tests.slow build/junit.xml
"""

from __future__ import annotations

import collections
import sys
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name("slow.txt")
SLOW_S = 2.0
"""All tests of a file together."""


def slow_files() -> frozenset[str]:
    """Paths from the checkout, as pytest names them; ValueError on one that is not there."""
    named = LIST.read_text().splitlines()
    gone = [name for name in named if not (ROOT / name).is_file()]
    if gone:
        raise ValueError(f"{LIST.name} names {', '.join(gone)}: no such file; write it again")
    return frozenset(named)


def measured(junit: Path) -> list[str]:
    """Files over `SLOW_S` in a run's JUnit file, by name."""
    seconds: collections.Counter[str] = collections.Counter()
    for case in ElementTree.parse(junit).getroot().iter("testcase"):
        name = case.get("classname", "").replace(".", "/") + ".py"
        seconds[name] += float(case.get("time", "0"))
    return sorted(name for name, spent in seconds.items() if spent > SLOW_S)


if __name__ == "__main__":
    LIST.write_text("\n".join(measured(Path(sys.argv[1]))) + "\n")
