"""What tests of commands share: a command in this process, a copy to spoil, a glTF read."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learning.__main__ import main
from lightstage.formats.processed import ProcessedFolder
from lightstage.interrupts import handlers_kept


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    """Exit code of a command; the handlers of signals are as before."""
    monkeypatch.setattr(sys, "argv", ["lightstage-learning", *map(str, words)])
    # A command that was interrupted leaves them ignored, as its process ends.
    with handlers_kept(), pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


def copied(person: Path, folder: Path) -> ProcessedFolder:
    shutil.copytree(person, folder / "copy")
    return ProcessedFolder(folder / "copy")


def accessor(glb: tuple[dict[str, Any], bytes], index: int) -> np.ndarray:
    """The numbers of an accessor of a glTF document and its binary part."""
    document, binary = glb
    fields = document["accessors"][index]
    view = document["bufferViews"][fields["bufferView"]]
    data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    if fields["type"] == "SCALAR":
        return np.frombuffer(data, "<u4").reshape(-1, 3)
    return np.frombuffer(data, "<f4").reshape(fields["count"], int(fields["type"][-1]))
