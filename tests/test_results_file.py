"""benchmarks/RESULTS.md: tables by subject, each with the command that makes it again."""

from __future__ import annotations

import math
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks import record as recording
from benchmarks.results_file import (
    SUBJECTS,
    Table,
    read_tables,
    results_text,
    subject_of,
    with_table,
)
from benchmarks.stale import changed_lines, code_lines, why_stale

BENCHMARKS = Path(recording.__file__).parent


def made(title: str, script: str, commit: str = "abc1234") -> Table:
    body = "What was measured.\n\n| a |\n|---|\n| 1 |"
    return Table(title, script, " --rows 96", "2026-01-02", commit, "2 cores, 8 GiB, X", body)


def test_the_results_are_in_the_order_that_their_writer_gives_them() -> None:
    text = recording.RESULTS.read_text()
    tables = read_tables(text)
    assert results_text(tables) == text
    assert len({table.title for table in tables}) == len(tables)
    for table in tables:
        assert (BENCHMARKS / f"{table.script}.py").is_file(), table.title


def test_every_link_of_the_contents_meets_a_heading() -> None:
    text = recording.RESULTS.read_text()
    links = re.findall(r"\]\(#(.*?)\)", text)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    anchors = [re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in headings]
    assert links
    assert set(links) <= set(anchors)


def test_every_benchmark_has_a_subject() -> None:
    for path in BENCHMARKS.glob("*.py"):
        if "import record" in path.read_text() and path.stem not in ("stale", "results_file"):
            assert subject_of(path.stem) in SUBJECTS


def test_a_new_table_takes_the_place_of_the_old_one_and_stands_under_its_subject() -> None:
    old = [made("Renderer: speed", "render_speed"), made("Ears", "registration_ears")]
    new = made("Ears", "registration_ears", "def5678")
    text = results_text(with_table(old, new))
    assert read_tables(text) == [new, old[0]]
    assert text.index("## Template and registration") < text.index("## Renderer")
    assert "abc1234, 2 cores" in text
    with pytest.raises(ValueError, match="no subject"):
        results_text([made("Other", "other")])
    with pytest.raises(ValueError, match="no line that says how it was made"):
        read_tables("# Results\n\n### Title\n\nA table.\n")


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A repository of one benchmark and its RESULTS.md; returns what calls git in it."""

    def git(*words: str) -> None:
        who = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        subprocess.run(["git", "-C", str(tmp_path), *who, *words], check=True, capture_output=True)

    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "RESULTS.md").write_text("# Results\n")
    (tmp_path / "benchmarks" / "render_speed.py").write_text("one = 1\n")
    git("init", "-q")
    git("add", "-A")
    git("commit", "-q", "-m", "first")
    monkeypatch.setattr(recording, "RESULTS", tmp_path / "benchmarks" / "RESULTS.md")
    monkeypatch.setattr("sys.argv", ["render_speed.py", "--rows", "a b"])
    monkeypatch.setattr(recording, "running", lambda: "render_speed")
    return git


def test_a_table_is_recorded_with_its_command_and_not_from_a_changed_tree(
    repository, capsys
) -> None:
    recording.record("Renderer: speed", ["ms"], [["3"]], "Note.")
    (table,) = read_tables(recording.RESULTS.read_text())
    assert (table.script, table.options) == ("render_speed", " --rows 'a b'")
    assert table.commit == recording.commit()
    assert table.body == "Note.\n\n| ms |\n|---|\n| 3 |"
    before = recording.RESULTS.read_text()
    (recording.RESULTS.parent / "render_speed.py").write_text("one = 2\n")
    recording.record("Renderer: speed", ["ms"], [["4"]], "Note.")
    assert recording.RESULTS.read_text() == before
    shown = capsys.readouterr()
    assert "| 4 |" in shown.out
    assert "benchmarks/render_speed.py differ from commit" in shown.err


def test_a_table_is_stale_once_code_that_it_measures_has_changed(repository) -> None:
    table = made("Renderer: speed", "render_speed", recording.commit())
    files = ["benchmarks/render_speed.py", "benchmarks/new.py"]
    assert why_stale(table, files) == (0, "")
    (recording.RESULTS.parent / "render_speed.py").write_text('"""New."""\n\none = 1  # still\n')
    repository("commit", "-qam", "comments")
    assert why_stale(table, files) == (0, "")
    (recording.RESULTS.parent / "render_speed.py").write_text("one = 2\n")
    repository("commit", "-qam", "code")
    assert why_stale(table, files) == (2, "2 lines of code in 1 file")
    (recording.RESULTS.parent / "new.py").write_text("two = 2\n")
    repository("add", "-A")
    repository("commit", "-qm", "more")
    assert why_stale(table, files) == (3, "3 lines of code in 2 files")
    assert why_stale(table, ["benchmarks/other.py"]) == (0, "")
    gone = made("Renderer: speed", "render_speed", "0123456")
    assert why_stale(gone, files) == (math.inf, "no commit 0123456 in the history")


def test_comments_docstrings_and_layout_are_no_code() -> None:
    plain = "class A:\n    b = 1\n\n    def c(self, d):\n        return 'text'\n"
    told = (
        '"""A file."""\n\nclass A:\n    """A class."""\n\n    b = (\n        1  # one\n    )\n'
        '    """About b."""\n\n    def c(self, d):\n        """Say."""\n        return "text"\n'
    )
    assert code_lines(told) == code_lines(plain)
    assert code_lines(plain.replace("text", "other")) != code_lines(plain)
    assert code_lines('def a():\n    """Nothing else."""\n') == ("def a():",)


def test_lines_that_only_moved_are_a_change() -> None:
    assert changed_lines(("a", "b"), ("a", "b")) == 0
    assert changed_lines(("a", "b"), ("b", "a")) == 1
    assert changed_lines(("a", "b", "b"), ("a", "c", "b")) == 2
