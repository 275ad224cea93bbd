"""A training that begins with another run's weights: what it takes over, and what it refuses."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from learning.checkpoint import AVERAGE, INDEX, load_tensors, read_checkpoint, shipped_mesostructure
from learning.commands import train_command
from learning.config import TrainingConfig
from learning.errors import CheckpointError
from learning.train import TRAINERS, other_rows, train
from lightstage.commands import quiet
from lightstage.errors import ConfigError
from lightstage.formats.files import write_json
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import build_store, open_store
from tests.learning import (
    test_four,
    test_mesostructure,
    test_training,
    test_upscale,
    test_whole_face,
)
from tests.learning.test_whole_face import stopping_after

SHORT = dataclasses.replace(
    test_whole_face.TINY, steps=3, ema=0.5, detail_pairs=1, doubt_faces=4, score_lights=1
)
"""A whole-face training of three steps."""
EACH = [
    test_whole_face.TINY,
    test_training.TINY,
    test_four.TINY,
    test_upscale.TINY,
    test_mesostructure.TINY,
]


@pytest.mark.parametrize("config", EACH, ids=lambda config: config.family)
@pytest.mark.parametrize("ema", [0.0, 0.5])
def test_every_family_begins_with_the_weights_to_infer_with_and_a_new_optimiser(
    config: TrainingConfig, ema: float
) -> None:
    make = TRAINERS[config.family][0]
    first, second = (make(dataclasses.replace(config, ema=ema, seed=seed)) for seed in (0, 1))
    state = first.tensors()
    weights = {name: value + 0.5 for name, value in state[AVERAGE if ema else make.role].items()}
    second.begin_with(weights, Path("run"))
    taken = second.tensors()
    for role in {make.role, *([AVERAGE] if ema else [])}:
        assert all(torch.equal(taken[role][name], weights[name]) for name in weights)
    assert not any("adam" in name for name in taken["training"])


@pytest.fixture(scope="module")
def begun(store_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of whole faces."""
    out = tmp_path_factory.mktemp("begun") / "run"
    train(open_store(store_path), out, SHORT)
    return out


def test_weights_that_leave_the_lab_do_not_take_along_what_draws_published_patches(
    begun: Path, store_path: Path, people: list[ProcessedFolder], tmp_path: Path
) -> None:
    checkpoint = read_checkpoint(begun)
    scans = [s for s in open_store(store_path).scans if s.subject not in checkpoint.held_out]
    assert checkpoint.trained_on == tuple(sorted(scan.trace for scan in scans))
    assert not any(scan.sha256 in (begun / INDEX).read_text() for scan in scans)
    # Those of an earlier version had it: their people are known all the same.
    older = shutil.copytree(begun, tmp_path / "older")
    value = json.loads((older / INDEX).read_text())
    write_json(older / INDEX, {**value, "trained_on": [scan.sha256 for scan in scans]})
    store = open_store(build_store([p.root for p in people[:2]], tmp_path / "store"))
    with pytest.raises(CheckpointError, match=r"trained on \(person-1\)"):
        train(store, tmp_path / "run", SHORT, begin_with=older)


def test_whole_faces_keep_the_people_that_the_first_run_knew(
    begun: Path, people: list[ProcessedFolder], tmp_path: Path
) -> None:
    others = open_store(build_store([people[k].root for k in (0, 2)], tmp_path / "store"))
    still = dataclasses.replace(SHORT, learning_rate=1e-9, weight_decay=0.0, ema=0.0)
    out = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        train(others, out, still, progress=stopping_after(1), begin_with=begun)
    assert train(others, out, still, resume=True).steps == 3
    first, second = read_checkpoint(begun), read_checkpoint(out)
    assert second.began_with == first.files
    before, after = load_tensors(first, AVERAGE), load_tensors(second, "network")
    measured = ("mode_doubt", "detail_shares")
    for name in before.keys() - set(measured):
        torch.testing.assert_close(after[name], before[name], atol=1e-6, rtol=0)
    alone = train(others, tmp_path / "alone", still)
    own = load_tensors(read_checkpoint(alone.checkpoint), "network")
    assert not torch.allclose(own["mean_log_albedo"], before["mean_log_albedo"], atol=1e-3)
    assert read_checkpoint(alone.checkpoint).began_with == {}


def test_networks_that_do_not_suit_are_refused_and_nothing_is_written(
    begun: Path, store_path: Path, people: list[ProcessedFolder], tmp_path: Path
) -> None:
    store, out = open_store(store_path), tmp_path / "run"

    def refused(config: TrainingConfig, run: Path = begun) -> CheckpointError:
        with pytest.raises(CheckpointError) as caught:
            train(store, out, config, begin_with=run)
        assert not out.exists()
        return caught.value

    assert "expected super_resolution" in str(refused(test_upscale.TINY))
    wider = dataclasses.replace(SHORT.network, width=8)
    assert "weights" in str(refused(dataclasses.replace(SHORT, network=wider)))
    faces = dataclasses.replace(SHORT.faces, held_out_subjects=2)
    known = str(refused(dataclasses.replace(SHORT, faces=faces)))
    assert "found 1 person that it was trained on (person-1)" in known
    # Of another store with some of the same people, too.
    store = open_store(build_store([p.root for p in people[:2]], tmp_path / "store"))
    assert "found 1 person that it was trained on (person-1)" in str(refused(SHORT))
    with pytest.raises(Exception, match="no such file"):
        train(store, out, SHORT, begin_with=tmp_path / "none")
    assert not out.exists()


@pytest.fixture
def command(store_path: Path, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """`train` as the command line calls it."""

    def call(preset: str, begin_with: str, resume: bool = False) -> dict[str, Any]:
        out = tmp_path / "run"
        return train_command(
            store_path, out, preset, None, 0.1, None, resume, quiet, "cpu", begin_with=begin_with
        )

    return call


def test_a_run_that_is_resumed_has_weights_of_its_own(command: Callable[..., Any]) -> None:
    with pytest.raises(ConfigError, match="with --resume, expected one of the two"):
        command("modern", "shipped", resume=True)


def test_shipped_weights_of_a_family_without_any_are_refused(command: Callable[..., Any]) -> None:
    with pytest.raises(ConfigError, match="shipped, for a network of the family 'patches'"):
        command("demo", "shipped")


def test_weights_that_know_detail_of_another_size_are_warned_of(
    begun: Path, store_path: Path
) -> None:
    store = open_store(store_path)
    known = "trained on maps of 1536 rows and these have 96"
    assert known in other_rows(shipped_mesostructure(), test_mesostructure.TINY, store)
    assert other_rows(begun, test_mesostructure.TINY, store) == ""
    assert other_rows(shipped_mesostructure(), SHORT, store) == ""
    assert other_rows(None, test_mesostructure.TINY, store) == ""
