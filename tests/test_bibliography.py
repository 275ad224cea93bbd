"""Every source that a docstring names stands in the bibliography, once."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("lightstage", "processing", "learning", "sim", "benchmarks", "demo")


def test_every_key_resolves_and_is_used() -> None:
    entries = re.findall(r"^@\w+\{([^,]+),", (ROOT / "BIBLIOGRAPHY.bib").read_text(), re.M)
    assert len(entries) == len(set(entries))
    text = "\n".join(p.read_text() for name in PACKAGES for p in (ROOT / name).rglob("*.py"))
    cited = set()
    for group in re.findall(r"\[((?:[A-Z][\w-]+(?:, )?)+)\]", text):
        cited |= {key for key in group.split(", ") if re.search(r"\d{2,}[a-z]?$|^WCAG", key)}
    assert cited - set(entries) == set()
    assert set(entries) - cited == set()
