"""What the tests of `export` share: the command in this process, and a copy to spoil."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from learning.__main__ import main
from lightstage.formats.processed import ProcessedFolder


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["lightstage-learning", *map(str, words)])
    with pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


def copied(person: Path, folder: Path) -> ProcessedFolder:
    shutil.copytree(person, folder / "copy")
    return ProcessedFolder(folder / "copy")
