"""Results of the accuracy benchmark in a file, so that a long run can be done in parts."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.reflectance_case import Result
from lightstage.formats.files import read_json, sha256_file, write_json
from processing.records import code_version, hash_of

SCHEMA = "lightstage.reflectance-accuracy/1"

Key = tuple[str, str, str]
"""Light, person and method."""


@functools.cache
def version() -> str:
    """SHA-256 of all code that a figure depends on: processing's and this benchmark's."""
    here = Path(__file__).parent
    own = sorted(here.glob("reflectance_*.py"))
    return hash_of(code_version(), [(path.name, sha256_file(path)) for path in own])


class Store:
    """Results by light, person and method; written after each."""

    def __init__(self, path: Path | None, scale: float) -> None:
        """Read what an earlier run of the same code left: results, and the peers' grid.

        Args:
            path: JSON; None keeps nothing.
            scale: of the pictures; results of another are not taken.
        """
        self._path = path
        self._facts = {"schema": SCHEMA, "version": version(), "scale": scale}
        self.results: dict[Key, Result] = {}
        self.grid: list[list[str]] = []
        if path is not None and path.is_file():
            kept: Mapping[str, Any] = read_json(path)
            if {key: kept.get(key) for key in self._facts} == self._facts:
                self.results = {tuple(key): _result(found) for key, found in kept["results"]}
                self.grid = kept["grid"]

    def put(self, key: Key, result: Result) -> None:
        """Add a result."""
        self.results[key] = result
        self._write()

    def put_grid(self, rows: list[list[str]]) -> None:
        """Add the rows of the peers' settings."""
        self.grid = rows
        self._write()

    def _write(self) -> None:
        if self._path is not None:
            rows = [[list(k), dataclasses.asdict(found)] for k, found in self.results.items()]
            write_json(self._path, {**self._facts, "grid": self.grid, "results": rows})


def _result(found: Mapping[str, Any]) -> Result:
    parts = [tuple(row) for row in found["deciles"]]
    return Result(found["every"], found["sure"], parts)
