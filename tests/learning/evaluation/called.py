"""What the tests of `evaluate` share: how the command ended, and a copy with another albedo."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.processed import ProcessedFolder


@dataclasses.dataclass(frozen=True)
class Ended:
    """How the command ended."""

    code: int
    out: str
    err: str

    @property
    def facts(self) -> dict[str, Any]:
        assert self.code == 0, self.err
        found: dict[str, Any] = json.loads(self.out.strip().splitlines()[-1])
        return found


def brightened(person: ProcessedFolder, to: Path, factor: float | np.ndarray) -> Path:
    """A person's maps, the albedo times a factor."""
    shutil.copytree(person.root / "atlas", to)
    albedo = read_exr(to / "diffuse_albedo.exr")
    write_exr(to / "diffuse_albedo.exr", (albedo * factor).astype(np.float32))
    return to
