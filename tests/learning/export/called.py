"""What tests of commands share: a command in this process, a copy to spoil, a glTF read."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.processed import ProcessedFolder
from tests.programs import run_program


def printed(*words: object) -> str:
    """What a command prints that ends well."""
    ended = run_program("learning", *words)
    assert ended.code == 0, ended.err
    return ended.out


def refusal(*words: object) -> str:
    """What a command reports that refuses its input."""
    ended = run_program("learning", *words)
    assert ended.code == 2, ended
    return ended.err


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
