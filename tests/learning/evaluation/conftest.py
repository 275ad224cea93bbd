"""The command in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.learning.evaluation.called import Ended
from tests.learning.export.called import run


@pytest.fixture
def evaluate(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Ended]:
    def call(*words: str | Path) -> Ended:
        code = run(monkeypatch, "evaluate", *words, "--json")
        ended = capsys.readouterr()
        return Ended(code, ended.out, ended.err)

    return call
