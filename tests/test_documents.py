"""What the README and docs/dataset.md tell a user to type is there, and works."""

from __future__ import annotations

import ast
import functools
import json
import re
import shlex
import tomllib
import typing
from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.formats.files import write_json
from processing.dataset import CHANNELS, build_store, open_store, publish, read_about
from processing.dataset.release_files import CHANNELS as PUBLISHED_CHANNELS
from tests.documents import (
    PACKAGES,
    ROOT,
    blocks,
    broken_links,
    commands,
    defined,
    drawn_layers,
    long_lines,
    missing_paths,
    named_symbols,
    options,
    run_as_written,
    table_code,
)
from tests.processing.releases import ABOUT_FILE

README = (ROOT / "README.md").read_text()
DATASET = (ROOT / "docs" / "dataset.md").read_text()
ARCHITECTURE = (ROOT / "ARCHITECTURE.md").read_text()
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CONTRACTS = PYPROJECT["tool"]["importlinter"]["contracts"]
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "firmware" / "README.md"]
WITHIN = "Within `lightstage`"
PEOPLE = ("person-0000", "person-0001", "person-0002")


@functools.cache
def help_of(*words: str) -> str:
    """What `WORDS --help` says."""
    printed = run_as_written(shlex.join([*words, "--help"]), ROOT)
    assert printed.code == 0, printed.err
    return printed.out


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_meets_a_file_and_its_heading(page: Path) -> None:
    assert broken_links(page) == []


def test_links_to_a_missing_file_or_heading_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# Title\n\n## `a.json`: b, c\n\n## Twice\n\n## Twice\n\n"
        "```\n[x](gone.md)\n## Code\n```\n\n"
        "[1](#ajson-b-c) [2](page.md#twice-1) [3](https://example.org/#x) [4](.)\n"
        "[5](#twice-2) [6](#code) ![7](gone.jpg) [8](page.md#tit)\n"
    )
    assert broken_links(page) == ["#twice-2", "#code", "gone.jpg", "page.md#tit"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_line_of_prose_is_longer_than_130_characters(page: Path) -> None:
    assert long_lines(page.read_text(), 130) == []


def test_a_long_line_of_prose_is_found_and_tables_and_code_may_be_long() -> None:
    long = "a word " * 3
    page = f"{long}\n- {long}\n| {long} |\n![{long}](a.png)\n```\n{long}\n```\nshort\n{'a' * 30}\n"
    assert long_lines(page, 20) == [long, f"- {long}"]


@pytest.mark.parametrize("page", ["README.md", "ARCHITECTURE.md"])
def test_every_file_and_name_that_shows_where_something_is_is_there(page: str) -> None:
    text = (ROOT / page).read_text()
    assert missing_paths(text) == []
    symbols = named_symbols(text)
    assert len(symbols) > 15
    assert [each for each in symbols if each[1] not in defined(ROOT / each[0])] == []


def test_a_file_or_name_that_is_not_there_is_found() -> None:
    page = (
        "`processing/gone.py` and `tests/documents.py` (`ROOT`, `gone`)\n\n"
        "| `lightstage/leds/`, `rig/` | `address.py`, `gone_*.py`, `wire*.py`, `gone/` |\n"
    )
    assert missing_paths(page) == ["processing/gone.py", "gone_*.py", "gone/"]
    assert named_symbols(page) == [("tests/documents.py", "ROOT"), ("tests/documents.py", "gone")]
    assert {"ROOT", "anchors"} < defined(ROOT / "tests" / "documents.py")
    assert "gone" not in defined(ROOT / "tests" / "documents.py")
    assert "AtlasConfig.rows" in defined(ROOT / "processing" / "atlas" / "config.py")


@pytest.mark.parametrize(
    ("heading", "contract", "prefix"),
    [
        (WITHIN, "lightstage's capture side", "lightstage."),
        ("## Inside `processing`", "processing's layers", ""),
    ],
)
def test_the_drawings_of_layers_are_the_contracts_of_imports(
    heading: str, contract: str, prefix: str
) -> None:
    (layers,) = [c["layers"] for c in CONTRACTS if c["name"].startswith(contract)]
    wanted = [{each.removeprefix(prefix) for each in layer.split(" | ")} for layer in layers]
    assert drawn_layers(ARCHITECTURE, heading) == wanted


def test_every_module_of_lightstage_is_of_the_floor_or_of_its_capture_side() -> None:
    drawn = {name.split(".")[0] for line in drawn_layers(ARCHITECTURE, WITHIN) for name in line}
    (floor,) = [c["source_modules"] for c in CONTRACTS if c["name"].startswith("the floor")]
    (side,) = [c["forbidden_modules"] for c in CONTRACTS if c["name"].startswith("the floor")]
    assert {module.removeprefix("lightstage.") for module in side} == drawn
    found = [*(ROOT / "lightstage").glob("*.py"), *(ROOT / "lightstage").glob("*/__init__.py")]
    names = {(path.parent if path.stem == "__init__" else path).stem for path in found}
    inside = names - {"lightstage", "__main__"}
    assert {module.removeprefix("lightstage.") for module in floor} == inside - drawn


def test_the_table_of_what_learning_may_import_is_its_contract() -> None:
    (rules,) = [c["ignore_imports"] for c in CONTRACTS if "independence" in c["type"]]
    allowed = {tuple(rule.split(" -> ")) for rule in rules}
    rows = ARCHITECTURE.split("| package of `learning` |")[1].split("\n\n")[0].splitlines()[2:]
    stated = set()
    for row in rows:
        package, modules = row.strip("|").split("|")
        source = "learning" if package.strip() == "all" else f"learning.{package.strip(' `')}"
        stated |= {(source, f"processing.{m}") for m in re.findall("`([^`]+)`", modules)}
    shortened = {(a.removesuffix(".**").removesuffix(".uv"), b) for a, b in allowed}
    assert stated == shortened


def test_every_configuration_of_processing_is_in_a_config_file_under_its_own_name() -> None:
    found = [
        (node.name, path.name)
        for path in (ROOT / "processing").rglob("*.py")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef) and node.name.endswith("Config")
    ]
    assert len(found) > 20
    assert {file for _, file in found} == {"config.py", "pipeline_config.py"}
    assert len({name for name, _ in found}) == len(found)


def test_every_command_of_the_readmes_steps_begins_with_a_programs_name() -> None:
    table = README.split("## What the demo does")[1].split("\n## ")[0]
    assert {code.split(" ")[0] for code in table_code(table)} <= set(PACKAGES)


def test_the_capturing_page_begins_with_commands_that_make_each_folder_before_it_is_read() -> None:
    first = blocks((ROOT / "docs" / "capture.md").read_text(), "")[0]
    made: set[str] = set()
    for command in commands(f"```\n{first}```"):
        read, _, written = command.partition(" --out ")
        folders = set(re.findall(r"\b[A-Z]{3,}\b", read)) - {"KIND", "URL"}
        assert folders <= made, command
        made |= set(re.findall(r"^[A-Z]{3,}\b", written))
    assert made == {"LAB", "CALIBRATION", "CAMERAS", "SESSION"}


def test_the_templates_page_names_every_command_of_processing_that_takes_a_template() -> None:
    text = " ".join((ROOT / "docs" / "template.md").read_text().split())
    named = re.search(r"((?:`[a-z-]+`(?:, | and )?)+) take the folder as `--template T`", text)
    assert named is not None
    listed = help_of("lightstage-processing").split("Commands:")[1]
    commands_there = re.findall(r"^  ([a-z-]+)  ", listed, re.MULTILINE)
    taking = {
        name for name in commands_there if "--template " in help_of("lightstage-processing", name)
    }
    assert set(re.findall(r"`([a-z-]+)`", named[1])) == taking


@pytest.mark.parametrize("command", sorted({c.split(" --")[0] for c in commands(README)}))
def test_every_option_that_the_readme_names_is_one_of_its_command(command: str) -> None:
    words = shlex.split(command)
    # The words before the first that names a file: a program and its subcommands.
    names = [word for word in words[:3] if word.replace("-", "").islower() and "." not in word]
    printed = help_of(*names)
    for written in commands(README):
        if written.startswith(command):
            assert [o for o in sorted(options(written)) if o not in printed] == []


def test_the_commands_and_examples_of_the_datasets_page_run_as_written(
    tmp_path: Path, make_processed: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    for index, name in enumerate(PEOPLE):
        make_processed(tmp_path / "P" / f"{name}-neutral", 192, 128, subject=name, seed=index)
    make_processed(tmp_path / "NEW", 192, 128, subject="person-0009", seed=9)
    write_json(tmp_path / "P" / "people.json", {"schema": "lightstage.people/1", "people": []})
    (tmp_path / "P" / "people.lock").write_text("")
    about, *_ = blocks(DATASET, "toml")
    (tmp_path / "ABOUT.toml").write_text(about)
    ran = []
    for command in commands(DATASET):
        if command.startswith("lightstage-processing dataset"):
            done = run_as_written(command, tmp_path)
            assert done.code == 0, f"{command}\n{done.err}"
            ran.append(command.split(" ")[2])
            if "build" in command:
                assert "skipped people.json, people.lock" in done.out
    assert ran[:2] == ["build", "publish"]
    monkeypatch.chdir(tmp_path)
    examples = blocks(DATASET, "python")
    assert len(examples) >= 2
    for example in examples:
        exec(compile(example, "docs/dataset.md", "exec"), {"__name__": "example"})
    train = "lightstage-learning train --preset demo --data PUB --out RUN"
    refused = run_as_written(train, tmp_path)
    assert refused.code == 2
    assert "dataset.json" in refused.err
    assert "the whole texture" in refused.err
    assert "Traceback" not in refused.err
    assert json.loads((tmp_path / "PUB" / "dataset.json").read_text())["counts"]["subjects"] == 3


def fields(value: object, name: str = "") -> set[str]:
    """Dotted names of all values of a JSON file, those of a map with NAME for it."""
    if isinstance(value, dict):
        below = [fields(each, f"{name}.{key}" if name else key) for key, each in value.items()]
        return set().union(*below)
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return set().union(*(fields(each, f"{name}[]") for each in value))
    for part in ("_mean", "_deviation", ""):
        start, _, last = name.rpartition(".")
        if last.removesuffix(part) in {*CHANNELS, *PUBLISHED_CHANNELS} and last.endswith(part):
            return {f"{start}.NAME{part}"}
    return {name}


def test_the_datasets_page_explains_every_field_that_is_written_and_no_other(
    tmp_path: Path, make_processed: Callable[..., Path]
) -> None:
    roots = [
        make_processed(tmp_path / name, 192, 128, subject=name, seed=index)
        for index, name in enumerate(PEOPLE)
    ]
    store = build_store(roots, tmp_path / "S")
    published = publish(open_store(store), tmp_path / "P", about=read_about(ABOUT_FILE))
    written = {"store": store, "published": published}
    found = {
        (field, kind)
        for kind, folder in written.items()
        for field in fields(json.loads((folder / "dataset.json").read_text()))
    }
    table = DATASET.split("## Every field of dataset.json")[1].split("\n## ")[0]
    rows = [line.split(" | ") for line in table.splitlines() if line.startswith("| `")]
    stated = [
        (row[0].strip("| `"), kind)
        for row in rows
        for kind in (written if row[1] == "both" else [row[1]])
    ]
    assert len(stated) == len(set(stated))
    assert set(stated) == found
    assert all(len(row) == 3 and len(row[2]) > 4 for row in rows)


@pytest.mark.parametrize("command", commands((ROOT / "docs" / "learning.md").read_text()))
def test_every_command_of_the_learning_page_has_the_options_that_it_is_given(command: str) -> None:
    printed = help_of(*shlex.split(command)[:2])
    assert [option for option in sorted(options(command)) if option not in printed] == []


def test_the_pages_name_every_family_of_networks_and_every_mode_of_shading() -> None:
    from learning.render.occlusion_training import OcclusionTrainConfig
    from learning.render.skin import Mode
    from learning.train import TRAINERS

    def row_of(page: str, field: str) -> str:
        text = (ROOT / "docs" / page).read_text()
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{field}` |")]
        return row

    named = set(re.findall(r"`(\w+)`", row_of("formats.md", "family")))
    assert named == {"family", OcclusionTrainConfig.family, *TRAINERS}
    named = set(re.findall(r"`(\w+)`", row_of("learning.md", "shading")))
    assert named == {"shading", *typing.get_args(Mode)}


def test_the_configuration_of_the_learning_page_is_taken_as_written() -> None:
    from learning.presets import preset
    from learning.whole.config import WholeTrainConfig

    (example,) = blocks((ROOT / "docs" / "learning.md").read_text(), "toml")
    found = preset("modern", tomllib.loads(example), "docs/learning.md")
    assert isinstance(found, WholeTrainConfig)
    assert found.network.width == 24
