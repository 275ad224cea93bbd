"""Which tables of RESULTS.md are older than the code that they measure: `make bench-stale`."""

from __future__ import annotations

from pathlib import Path

import grimp

from benchmarks.record import RESULTS, git
from benchmarks.record import table as markdown
from benchmarks.results_file import Table, read_tables

PACKAGES = ("benchmarks", "lightstage", "processing", "learning", "sim")


def measured_files(script: str, graph: grimp.ImportGraph, root: Path) -> list[str]:
    """Files of this project that a benchmark's module imports, directly or not, and its own.

    Args:
        script: name of the benchmark in `benchmarks`.
        graph: of the imports of `PACKAGES`.
        root: of the repository.
    """
    module = f"benchmarks.{script}"
    modules = {module, *graph.find_upstream_modules(module)} - {"benchmarks.record"}
    files = []
    for name in modules:
        path = root / name.replace(".", "/")
        files.append(path / "__init__.py" if path.is_dir() else path.with_suffix(".py"))
    return sorted(str(path.relative_to(root)) for path in files if path.is_file())


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
    graph = grimp.build_graph(*PACKAGES)
    rows = []
    tables = read_tables(RESULTS.read_text())
    for made in tables:
        if f"benchmarks.{made.script}" not in graph.modules:
            rows.append([made.title, made.script, made.date, "its script is gone"])
            continue
        why = why_stale(made, measured_files(made.script, graph, root))
        if why:
            rows.append([made.title, made.script, made.date, why])
    print(markdown(["table", "benchmark", "date", "why"], rows))
    print(f"\n{len(rows)} of {len(tables)} tables are older than the code that they measure.")


if __name__ == "__main__":
    main()
