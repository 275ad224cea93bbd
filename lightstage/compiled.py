"""Where numba keeps compiled loops: apart for every commit of a checkout.

Numba compiles a function again when its own file changed, but not when a function or a constant of
another file did that was compiled into it: after an update it would run old code without a word.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

KEPT = 4
"""Commits whose compiled code stays."""


def keep_apart(root: Path) -> None:
    """Have numba keep what it compiles in ROOT/build/compiled/COMMIT, older commits' removed.

    Call it before numba is imported. Without a checkout, where the folder cannot be written, or
    where NUMBA_CACHE_DIR is set, nothing is changed.

    Args:
        root: of the checkout.
    """
    commit = commit_of(root)
    if commit is None or "NUMBA_CACHE_DIR" in os.environ:
        return
    folder = root / "build" / "compiled" / commit
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        others = [other for other in folder.parent.iterdir() if other != folder]
        others.sort(key=lambda other: other.stat().st_mtime, reverse=True)
    except OSError:
        return
    for other in others[KEPT - 1 :]:
        shutil.rmtree(other, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)


def commit_of(root: Path) -> str | None:
    """The commit of a checkout; None where it is none, or cannot be read."""
    git = root / ".git"
    try:
        if git.is_file():  # a worktree of its own: the file names its folder
            git = root / git.read_text().removeprefix("gitdir:").strip()
        head = (git / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head if _is_digest(head) else None
        branch = head.removeprefix("ref: ")
        shared = git / "commondir"  # branches are the checkout's that the worktree belongs to
        if shared.is_file():
            git = git / shared.read_text().strip()
        loose = git / branch
        if loose.is_file():
            found = loose.read_text().strip()
            return found if _is_digest(found) else None
        for line in (git / "packed-refs").read_text().splitlines():
            digest, _, name = line.partition(" ")
            if name == branch and _is_digest(digest):
                return digest
    except (OSError, UnicodeDecodeError):
        pass
    return None


def _is_digest(text: str) -> bool:
    return len(text) >= 40 and all(letter in "0123456789abcdef" for letter in text)
