"""What a processed folder's report says of the libraries behind it."""

from __future__ import annotations

from importlib import metadata

import pytest

from processing.records import REPORTED, versions


def test_every_library_that_shapes_results_has_its_version() -> None:
    found = versions()
    assert set(REPORTED) <= set(found)
    assert all(found[name] for name in REPORTED)


@pytest.mark.parametrize("build", ["open3d", "open3d-cpu"])
def test_a_library_is_known_by_either_of_its_builds(
    build: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = metadata.version

    def version(name: str) -> str:
        if not name.startswith("open3d"):
            return known(name)
        if name != build:
            raise metadata.PackageNotFoundError(name)
        return "1.2.3"

    monkeypatch.setattr(metadata, "version", version)
    assert versions()["open3d"] == "1.2.3"
