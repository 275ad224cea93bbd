"""Append a benchmark's table to RESULTS.md with date, machine and commit."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

RESULTS = Path(__file__).parent / "RESULTS.md"


def machine() -> str:
    """Cores, memory and processor of this machine."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    model = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    return f"{os.cpu_count()} cores, {memory:.0f} GiB, {model}"


def commit() -> str:
    """The commit that ran; "+ changes" when a file other than RESULTS.md differs from it."""
    said = _git("rev-parse", "--short", "HEAD")
    changed = _git("status", "--porcelain", "--untracked-files=no")
    changed = "\n".join(line for line in changed.splitlines() if RESULTS.name not in line)
    return (said or "no commit") + (" + changes" if changed else "")


def _git(*words: str) -> str:
    asked = ["git", *words]
    return subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def record(title: str, header: Sequence[str], rows: Sequence[Sequence[object]], note: str) -> None:
    """Print a table and put it into RESULTS.md in place of the last one of the same title.

    Args:
        title: of the section, one a benchmark.
        header: column names with units.
        rows: cells, printed with str.
        note: one sentence on what was measured and on what data.
    """
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    lines = [f"## {title}", "", f"{today}, {machine()}, commit {commit()}. {note}", ""]
    section = "\n".join(lines) + "\n" + table(header, rows) + "\n"
    print(section)
    old = RESULTS.read_text() if RESULTS.exists() else "# Results\n"
    parts = old.split("\n## ")
    kept = [part for part in parts[1:] if part.split("\n", 1)[0] != title]
    text = parts[0].rstrip() + "\n\n" + section
    for part in kept:
        text += f"\n## {part.rstrip()}\n"
    RESULTS.write_text(text)
