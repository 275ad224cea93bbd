"""Which tables of RESULTS.md are older than the code that they measure: `make bench-stale`."""

from __future__ import annotations

from pathlib import Path

from benchmarks.record import RESULTS, git
from benchmarks.record import table as markdown
from benchmarks.results_file import Table, read_tables
from processing.reachable import reachable_files

PACKAGES = ("benchmarks", "lightstage", "processing", "learning", "sim")
WRITERS = ("benchmarks/record.py", "benchmarks/results_file.py")


def measured_files(script: str, root: Path) -> list[str]:
    """Files of this project that a benchmark imports, directly or not, and its own; sorted.

    How tables are written is not measured.
    """
    files = reachable_files(f"benchmarks.{script}", PACKAGES, root)
    names = [str(path.relative_to(root)) for path in files]
    return [name for name in names if name not in WRITERS]


def why_stale(table: Table, files: list[str]) -> str:
    """In words why a table should be made again; empty where it need not be."""
    if not git("rev-parse", "--verify", "--quiet", f"{table.commit}^{{commit}}"):
        return f"no commit {table.commit} in the history"
    changes = git("log", "--format=%h", f"{table.commit}..HEAD", "--", *files).split()
    if not changes:
        return ""
    lines = git("diff", "--shortstat", table.commit, "HEAD", "--", *files).strip()
    return f"{len(changes)} later commits: {lines or 'no lines in the end'}"


def main() -> None:
    root = RESULTS.parent.parent
    rows = []
    tables = read_tables(RESULTS.read_text())
    for made in tables:
        if not (RESULTS.parent / f"{made.script}.py").is_file():
            rows.append([made.title, made.script, made.date, "its script is gone"])
            continue
        why = why_stale(made, measured_files(made.script, root))
        if why:
            rows.append([made.title, made.script, made.date, why])
    print(markdown(["table", "benchmark", "date", "why"], rows))
    print(f"\n{len(rows)} of {len(tables)} tables are older than the code that they measure.")


if __name__ == "__main__":
    main()
