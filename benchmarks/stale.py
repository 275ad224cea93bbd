"""Which tables of RESULTS.md are older than the code that they measure: `make bench-stale`.

Code counts, comments and docstrings do not: a table is stale once a file that its benchmark imports
does something else. Those with the most changed lines come first.
"""

from __future__ import annotations

import ast
import functools
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.record import RESULTS, git
from benchmarks.record import table as markdown
from benchmarks.results_file import Table, read_tables
from lightstage.counting import counted
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


def why_stale(table: Table, files: list[str]) -> tuple[float, str]:
    """How many lines of code have changed since a table was made, and in words why it is stale.

    The words are empty where it need not be made again; lines are infinite where nobody can tell.
    """
    commit = git("rev-parse", "--verify", "--quiet", f"{table.commit}^{{commit}}")
    if not commit:
        return math.inf, f"no commit {table.commit} in the history"
    then, now = blobs(commit), blobs(git("rev-parse", "HEAD"))
    counts = [changed_lines(code(then.get(name)), code(now.get(name))) for name in files]
    lines, changed = sum(counts), sum(count > 0 for count in counts)
    if not changed:
        return 0, ""
    return lines, f"{counted(lines, 'line')} of code in {counted(changed, 'file')}"


@functools.cache
def blobs(commit: str) -> dict[str, str]:
    """Path to the name of its content at a commit, given by its whole hash."""
    lines = git("ls-tree", "-r", commit).splitlines()
    return {path: facts.split()[2] for facts, _, path in (line.partition("\t") for line in lines)}


@functools.cache
def code(blob: str | None) -> tuple[str, ...]:
    """Lines of code of a content; none where there is no such file."""
    return () if blob is None else code_lines(git("cat-file", "blob", blob))


def code_lines(text: str) -> tuple[str, ...]:
    """A Python file's code as Python itself would write it: no comments, no docstrings."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        for name in ("body", "orelse", "finalbody"):
            block = getattr(node, name, None)
            if isinstance(block, list):
                setattr(node, name, [each for each in block if not _is_text(each)])
    return tuple(ast.unparse(tree).splitlines())


def changed_lines(before: Sequence[str], after: Sequence[str]) -> int:
    """Lines that only one of two texts has; 1 at least where they differ."""
    if before == after:
        return 0
    old, new = Counter(before), Counter(after)
    return max(1, (old - new).total() + (new - old).total())


def _is_text(node: ast.AST) -> bool:
    """Whether a statement is a string alone, as docstrings are."""
    if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
        return False
    return isinstance(node.value.value, str)


def main() -> None:
    root = RESULTS.parent.parent
    found: list[tuple[float, list[str]]] = []
    tables = read_tables(RESULTS.read_text())
    for made in tables:
        lines, why = math.inf, "its script is gone"
        if (RESULTS.parent / f"{made.script}.py").is_file():
            lines, why = why_stale(made, measured_files(made.script, root))
        if why:
            found.append((lines, [made.title, made.script, made.date, why]))
    found.sort(key=lambda one: -one[0])
    print(markdown(["table", "benchmark", "date", "changed since"], [row for _, row in found]))
    print(f"\n{len(found)} of {len(tables)} tables are older than the code that they measure.")


if __name__ == "__main__":
    main()
