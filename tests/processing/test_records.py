"""What a processed folder's report says of the libraries behind it."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import pytest

from lightstage.formats.population import FILE, POINTS_FILE
from lightstage.formats.template import default_template_path, load_template, save_template
from processing.records import REPORTED, hash_template, versions


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


def test_a_template_s_people_are_no_input_of_the_stages_and_its_mesh_is(tmp_path: Path) -> None:
    template = tmp_path / "T"
    save_template(load_template(default_template_path()), template)
    before = hash_template(template)
    for name in (FILE, POINTS_FILE):
        (template / name).write_bytes(b"other people")
    assert hash_template(template) == before
    with (template / "mesh.obj").open("a") as mesh:
        mesh.write("# another\n")
    assert hash_template(template) != before
