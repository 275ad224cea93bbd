"""Where the optional head data are; they are not part of this project."""

from __future__ import annotations

import os
from pathlib import Path


def head_data_folder(name: str, holds: str) -> Path | None:
    """A folder of the data that LIGHTSTAGE_DATA names, or that are beside the checkout.

    Args:
        name: of the folder.
        holds: what must be in it.

    Returns:
        The folder, None where it is absent.
    """
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    folder = Path(os.environ.get("LIGHTSTAGE_DATA", beside)) / name
    return folder if (folder / holds).exists() else None
