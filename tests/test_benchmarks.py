"""`make bench` calls every benchmark that needs no arguments, and no other."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def needs_arguments(source: str) -> bool:
    """Whether a script's arguments have one that must be given."""
    found = re.findall(r"\.add_argument\(\s*(.*?)\)\n", source, re.DOTALL)
    return any(
        "required=True" in each or (not each.startswith('"-') and 'nargs="*"' not in each)
        for each in found
    )


def test_make_bench_leaves_out_what_needs_arguments() -> None:
    makefile = (ROOT / "Makefile").read_text().replace("\\\n", " ")
    named = re.search(r"^BY_HAND := (.*)$", makefile, re.MULTILINE)
    assert named is not None
    scripts = sorted((ROOT / "benchmarks").glob("*.py"))
    asking = [path.stem for path in scripts if needs_arguments(path.read_text())]
    assert asking == named[1].split()


def test_no_benchmark_imports_a_test() -> None:
    importing = [
        path.name
        for path in sorted((ROOT / "benchmarks").glob("*.py"))
        if re.search(r"^\s*(from|import) tests\b", path.read_text(), re.MULTILINE)
    ]
    assert importing == []
