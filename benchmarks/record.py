"""Put a benchmark's table into RESULTS.md with its command, date, commit and machine."""

from __future__ import annotations

import datetime
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.results_file import Table, read_tables, results_text, with_table

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
    """Abbreviated hash of the commit that is checked out."""
    return git("rev-parse", "--short", "HEAD") or "none"


def changed() -> list[str]:
    """Tracked files other than RESULTS.md that differ from the commit."""
    lines = git("status", "--porcelain", "--untracked-files=no").splitlines()
    return [line[3:] for line in lines if RESULTS.name not in line]


def git(*words: str) -> str:
    """What git prints in this repository; nothing where it fails."""
    command = ["git", "-C", str(RESULTS.parent.parent), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.rstrip()


def running() -> str:
    """Name of the benchmark that runs, as `python -m benchmarks.NAME` has it."""
    spec = sys.modules["__main__"].__spec__
    return Path(sys.argv[0]).stem if spec is None else spec.name.rsplit(".", 1)[-1]


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def record(title: str, header: Sequence[str], rows: Sequence[Sequence[object]], note: str) -> None:
    """Print a table and put it into RESULTS.md in place of the last one of the same title.

    Nothing is written where tracked files differ from the commit: nobody could make it again.

    Args:
        title: of the section, one a benchmark.
        header: column names with units.
        rows: cells, printed with str.
        note: one sentence on what was measured and on what data.
    """
    made = Table(
        title,
        running(),
        "".join(f" {shlex.quote(word)}" for word in sys.argv[1:]),
        datetime.datetime.now(datetime.UTC).date().isoformat(),
        commit(),
        machine(),
        f"{note}\n\n{table(header, rows)}",
    )
    print(made.text())
    if files := changed():
        print(
            f"{RESULTS.name} is left as it is: {', '.join(files)} differ from commit "
            f"{made.commit}. Commit them and run this again.",
            file=sys.stderr,
        )
        return
    RESULTS.write_text(results_text(with_table(read_tables(RESULTS.read_text()), made)))
