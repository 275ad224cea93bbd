"""The command in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.learning.evaluation.called import Ended
from tests.programs import run_program


@pytest.fixture
def evaluate() -> Callable[..., Ended]:
    def call(*words: str | Path) -> Ended:
        ended = run_program("learning", "evaluate", *words, "--json")
        return Ended(ended.code, ended.out, ended.err)

    return call
