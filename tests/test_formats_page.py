"""docs/formats.md: its examples are read, and its column "needed" is what the readers do."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from learning.checkpoint import read_checkpoint
from lightstage.errors import LightstageError
from lightstage.formats.consents import read_consents
from lightstage.formats.environment import read_lights
from lightstage.formats.flats import read_flats
from lightstage.formats.landmarks import read_points_mm, read_points_px
from lightstage.formats.lights import read_measured_lights
from lightstage.formats.processed import MAPS
from lightstage.formats.session import load_session
from lightstage.formats.template import load_template
from lightstage.poses_from_photos.lenses import read_lenses
from lightstage.rig import load_rig
from processing.colour import read_colour
from processing.dataset import open_store
from processing.dataset.scan import read_head_pose
from processing.records import read_records
from tests.documents import ROOT

PAGE = (ROOT / "docs" / "formats.md").read_text()
EXAMPLES = dict(re.findall(r"^Example: `([^`]+)`\n\n```\w+\n(.*?)^```$", PAGE, re.M | re.S))
READERS: dict[str, Callable[[Path], Any]] = {
    "rig.json": lambda folder: load_rig(folder / "rig.json"),
    "wired.json": lambda folder: load_rig(folder / "wired.json"),
    "session.json": load_session,
    "landmarks.json": lambda folder: read_points_px(folder / "landmarks.json"),
    "L.json": lambda folder: read_points_mm(folder / "L.json"),
    "template.json": load_template,
    "head_from_world.json": lambda folder: read_head_pose(folder / "head_from_world.json"),
    "stages.json": read_records,
    "dataset.json": open_store,
    "consents.json": lambda folder: read_consents(folder / "consents.json"),
    "checkpoint.json": read_checkpoint,
    "colour.json": lambda folder: read_colour(folder / "colour.json", ["cam0"]),
    "flats.json": lambda folder: read_flats(folder / "flats.json", ["cam0"]),
    "lights.json": lambda folder: read_measured_lights(
        folder / "lights.json", load_rig(folder / "rig.json")
    ),
    "E.json": lambda folder: read_lights(folder / "E.json"),
    "lenses.json": lambda folder: read_lenses(folder / "lenses.json"),
}
ROW = re.compile(r"^\| `([^`|]+)` \| .* \| (yes|no) \|$", re.M)


def fields_of(name: str) -> list[tuple[str, bool]]:
    """Rows of the last table before a file's example: field, and whether it is needed."""
    before = PAGE[: PAGE.index(f"Example: `{name}`")]
    table = before[before.rindex("| field | holds | needed |") :]
    return [(field, needed == "yes") for field, needed in ROW.findall(table)]


def without(value: Any, field: str) -> Any:
    """A copy of a value that lacks a field, such as ``lights[].id``: in the first entry."""
    changed = copy.deepcopy(value)
    inner, words = changed, field.replace("[]", ".0").split(".")
    for word in words[:-1]:
        inner = inner[int(word)] if word.isdigit() else inner[word]
    del inner[words[-1]]
    return changed


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in EXAMPLES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def test_the_page_has_an_example_of_each_file_that_has_a_reader_here() -> None:
    assert set(EXAMPLES) == {*READERS, "mesh.obj"}


@pytest.mark.parametrize("name", READERS)
def test_an_example_is_read(folder: Path, name: str) -> None:
    assert READERS[name](folder) is not None


@pytest.mark.parametrize(
    ("name", "field", "needed"),
    [(name, field, needed) for name in READERS for field, needed in fields_of(name)],
)
def test_a_field_is_needed_where_the_page_states_it(
    folder: Path, name: str, field: str, needed: bool
) -> None:
    value = without(json.loads(EXAMPLES[name]), field)
    (folder / name).write_text(json.dumps(value))
    if needed:
        with pytest.raises(LightstageError):
            READERS[name](folder)
    else:
        READERS[name](folder)


@pytest.mark.parametrize("name", [n for n in READERS if '"schema"' in EXAMPLES.get(n, "")])
def test_a_newer_version_is_refused(folder: Path, name: str) -> None:
    text = EXAMPLES[name]
    schema = json.loads(text)["schema"]
    newer = schema.partition("/")[0] + "/99"
    (folder / name).write_text(text.replace(schema, newer))
    with pytest.raises(LightstageError, match="newer version"):
        READERS[name](folder)


def test_the_pages_maps_are_the_programs() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\d) \| (yes|no) \|", PAGE, re.M)
    values = {name: (int(channels), half == "yes") for name, channels, half in rows}
    assert values == {name: (spec.channels, spec.half) for name, spec in MAPS.items()}
