"""The Python of docs/renderer.md runs as written."""

from __future__ import annotations

from pathlib import Path

import pytest

from lightstage.formats.processed import ProcessedFolder
from tests.documents import ROOT, blocks


def test_the_python_of_the_renderers_page_runs_as_written_and_its_descent_descends(
    people: list[ProcessedFolder], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "OUT").symlink_to(people[0].root)
    page = (ROOT / "docs" / "renderer.md").read_text()
    (lights,) = blocks(page, "json")
    (tmp_path / "E.json").write_text(lights)
    (example,) = blocks(page, "python")
    monkeypatch.chdir(tmp_path)
    found: dict[str, list[float]] = {"losses": []}
    exec(compile(example, "docs/renderer.md", "exec"), found)
    assert len(found["losses"]) > 10
    assert found["losses"][-1] < 0.3 * found["losses"][0]
