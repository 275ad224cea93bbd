"""Compiled loops are those of the commit that a checkout stands at."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lightstage.compiled import KEPT, commit_of, keep_apart

FIRST, SECOND = "a" * 40, "b" * 40


def checkout(root: Path, commit: str = FIRST) -> Path:
    """A folder that git would take for a checkout of a branch at a commit."""
    branch = root / ".git" / "refs" / "heads" / "main"
    branch.parent.mkdir(parents=True, exist_ok=True)
    branch.write_text(commit + "\n")
    (root / ".git" / "HEAD").write_text("ref: refs/heads/main\n")
    return root


def test_the_commit_is_that_of_a_branch_a_packed_branch_or_a_detached_head(tmp_path: Path) -> None:
    root = checkout(tmp_path)
    assert commit_of(root) == FIRST
    (root / ".git" / "refs" / "heads" / "main").unlink()
    packed = root / ".git" / "packed-refs"
    packed.write_text(f"# pack-refs\n{FIRST} refs/heads/other\n{SECOND} refs/heads/main\n")
    assert commit_of(root) == SECOND
    (root / ".git" / "HEAD").write_text(FIRST)
    assert commit_of(root) == FIRST


def test_the_commit_of_a_worktree_is_that_of_its_own_branch(tmp_path: Path) -> None:
    main = checkout(tmp_path / "main")
    (main / ".git" / "refs" / "heads" / "side").write_text(SECOND)
    own = main / ".git" / "worktrees" / "side"
    own.mkdir(parents=True)
    (own / "HEAD").write_text("ref: refs/heads/side\n")
    (own / "commondir").write_text("../..\n")
    side = tmp_path / "side"
    side.mkdir()
    (side / ".git").write_text(f"gitdir: {own}\n")
    assert commit_of(side) == SECOND


@pytest.mark.parametrize("head", ["", "ref: refs/heads/none", "no digest", "ref: ../../up"])
def test_what_is_no_checkout_has_no_commit(tmp_path: Path, head: str) -> None:
    assert commit_of(tmp_path) is None
    (tmp_path / ".git").mkdir()
    (tmp_path / ".git" / "HEAD").write_text(head)
    assert commit_of(tmp_path) is None


def test_old_commits_code_is_removed_and_a_named_folder_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "build" / "compiled"
    for k in range(KEPT + 3):
        monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
        keep_apart(checkout(tmp_path, f"{k:040x}"))
        os.utime(folder / f"{k:040x}", (k, k))
    left = sorted(p.name for p in folder.iterdir())
    assert left == [f"{k:040x}" for k in range(3, KEPT + 3)]
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder / left[-1])
    monkeypatch.setenv("NUMBA_CACHE_DIR", "elsewhere")
    keep_apart(checkout(tmp_path, SECOND))
    assert os.environ["NUMBA_CACHE_DIR"] == "elsewhere"


def test_after_an_update_a_loop_uses_another_files_new_constant(tmp_path: Path) -> None:
    root = checkout(tmp_path)
    (root / "told.py").write_text("LEVEL = 1\n")
    (root / "loop.py").write_text(
        "from numba import njit\nimport told\n\n"
        "LEVEL = told.LEVEL\n\n"
        "@njit(cache=True)\ndef level():\n    return LEVEL\n"
    )
    run = (
        "from pathlib import Path; from lightstage.compiled import keep_apart;"
        f"keep_apart(Path({str(root)!r})); import loop; print(loop.level())"
    )
    bare = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    bare["PYTHONPATH"] = os.pathsep.join([str(root), str(Path(__file__).parents[2])])

    def answer() -> str:
        # The package sets the folder of its own checkout when it is imported.
        code = "import lightstage, os; os.environ.pop('NUMBA_CACHE_DIR', None);" + run
        command = [sys.executable, "-B", "-c", code]
        done = subprocess.run(command, env=bare, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    assert answer() == "1"
    (root / "told.py").write_text("LEVEL = 2\n")
    assert answer() == "1"  # what numba does where nothing tells it of an update
    checkout(root, SECOND)
    assert answer() == "2"
