"""What all tests share: where the optional head data lies."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def head_data_path() -> Path | None:
    """The folder with scanned heads, from LIGHTSTAGE_DATA or beside the checkout."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    path = Path(os.environ.get("LIGHTSTAGE_DATA", beside))
    return path if (path / "lps_head").is_dir() else None


@pytest.fixture(scope="session")
def head_data() -> Path:
    """The folder with scanned heads; skips where it is absent."""
    path = head_data_path()
    if path is None:
        pytest.skip("no head data: set LIGHTSTAGE_DATA or put it at ../shared/data")
    return path
