"""What the README and docs/dataset.md tell a user to type is there, and works."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.formats.files import write_json
from tests.documents import PACKAGES, ROOT, blocks, commands, options, run_as_written, table_code

README = (ROOT / "README.md").read_text()
DATASET = (ROOT / "docs" / "dataset.md").read_text()
PEOPLE = ("person-0000", "person-0001", "person-0002")


def test_every_command_of_the_readmes_steps_begins_with_a_programs_name() -> None:
    table = README.split("## What the demo does")[1].split("\n## ")[0]
    assert {code.split(" ")[0] for code in table_code(table)} <= set(PACKAGES)


@pytest.mark.parametrize("command", sorted({c.split(" --")[0] for c in commands(README)}))
def test_every_option_that_the_readme_names_is_one_of_its_command(command: str) -> None:
    words = shlex.split(command)
    # The words before the first that names a file: a program and its subcommands.
    names = [word for word in words[:3] if word.replace("-", "").islower() and "." not in word]
    said = run_as_written(shlex.join([*names, "--help"]), ROOT)
    assert said.returncode == 0, said.stderr
    for written in commands(README):
        if written.startswith(command):
            assert [o for o in sorted(options(written)) if o not in said.stdout] == []


def test_the_commands_and_examples_of_the_datasets_page_run_as_written(
    tmp_path: Path, make_processed: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    for index, name in enumerate(PEOPLE):
        make_processed(tmp_path / "P" / f"{name}-neutral", 192, 128, subject=name, seed=index)
    write_json(tmp_path / "P" / "people.json", {"schema": "lightstage.people/1", "people": []})
    (tmp_path / "P" / "people.lock").write_text("")
    ran = []
    for command in commands(DATASET):
        if command.startswith("lightstage-processing dataset"):
            done = run_as_written(command, tmp_path)
            assert done.returncode == 0, f"{command}\n{done.stderr}"
            ran.append(command.split(" ")[2])
            if "build" in command:
                assert "passed over people.json, people.lock" in done.stdout
    assert ran[:2] == ["build", "publish"]
    monkeypatch.chdir(tmp_path)
    examples = blocks(DATASET, "python")
    assert len(examples) >= 2
    for example in examples:
        exec(compile(example, "docs/dataset.md", "exec"), {"__name__": "example"})
    train = "lightstage-learning train --preset demo --data PUB --out RUN"
    refused = run_as_written(train, tmp_path)
    assert refused.returncode == 2
    assert "dataset.json" in refused.stderr
    assert "the whole texture" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert json.loads((tmp_path / "PUB" / "dataset.json").read_text())["counts"]["subjects"] == 3


@pytest.mark.parametrize("command", commands((ROOT / "docs" / "learning.md").read_text()))
def test_every_command_of_the_learning_page_has_the_options_that_it_is_given(command: str) -> None:
    said = run_as_written(" ".join([*shlex.split(command)[:2], "--help"]), ROOT)
    assert said.returncode == 0, said.stderr
    assert [option for option in sorted(options(command)) if option not in said.stdout] == []


def test_the_configuration_of_the_learning_page_is_taken_as_written() -> None:
    import tomllib

    from learning.presets import preset
    from learning.whole.config import WholeTrainConfig

    (example,) = blocks((ROOT / "docs" / "learning.md").read_text(), "toml")
    found = preset("modern", tomllib.loads(example), "docs/learning.md")
    assert isinstance(found, WholeTrainConfig)
    assert found.network.width == 24
