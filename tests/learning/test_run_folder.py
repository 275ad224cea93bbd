"""The folder of a training: one training at a time, resumed to the same bits, each step once."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.checkpoint import INDEX, load_generator
from learning.errors import CheckpointError, TrainingError
from learning.losses import maps_loss
from learning.patch_config import TrainConfig
from learning.run import Run
from learning.train import train
from learning.whole.config import WholeTrainConfig
from lightstage.errors import DiskError
from processing.dataset import open_store
from tests.learning.test_event_file import fields, records, scalars
from tests.learning.test_training import TINY


def run_interrupted(store_path: Path, out: Path, config: TrainConfig, after: int) -> None:
    def stop(done: int, total: int) -> None:
        if done == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(open_store(store_path), out, config, progress=stop)


def test_two_trainings_never_write_into_one_folder(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, refusals = tmp_path / "run", []

    def second(done: int, total: int) -> None:
        # While the first is at work; before its first checkpoint the folder looks like a new one.
        if done in (2, 4):
            with pytest.raises(CheckpointError, match="another training that writes there now"):
                train(open_store(store_path), out, TINY)
            refusals.append(done)

    result = train(open_store(store_path), out, TINY, progress=second)
    assert refusals == [2, 4]
    assert load_generator(out)[1].step == result.steps == 6
    assert steps_of(out / "metrics.jsonl") == [0, 1, 2, 3, 4, 5, 6]
    # One that began before the first had ended, and was slower to read its data.
    late = Run(out, TINY, {}, 0, 0.0)
    with pytest.raises(CheckpointError, match=r"found step 6, of another training"), late.alone():
        raise AssertionError("never here")

    def cannot(*_: object) -> None:
        raise DiskError(out, found="a disk that cannot lock a file", expected="one that can")

    monkeypatch.setattr("learning.run.locked", cannot)
    with Run(out, TINY, {}, 6, 0.0).alone():
        pass


def steps_of(metrics: Path) -> list[int]:
    return [json.loads(line)["step"] for line in metrics.read_text().splitlines()]


def test_a_run_that_is_resumed_logs_each_step_once_though_it_was_killed(
    store_path: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    run_interrupted(store_path, out, TINY, 2)
    metrics = out / "metrics.jsonl"
    kept = metrics.read_bytes()
    # As `kill -9` leaves it: steps after the checkpoint, the score of an end that was not saved.
    lost = [{"step": 2, "learning_rate": 1.0}, {"step": 5, "learning_rate": 1.0}, {"step": 6}]
    metrics.write_bytes(kept + b"".join(json.dumps(line).encode() + b"\n" for line in lost))
    with metrics.open("ab") as file:
        file.write(b'{"step": 7, "maps')  # a line whose middle the kill met
    before = set(out.glob("events.*"))
    assert train(open_store(store_path), out, TINY, resume=True).steps == 6
    assert metrics.read_bytes().startswith(kept)
    # What earlier files have from step 2 on is void to TensorBoard.
    (resumed,) = set(out.glob("events.*")) - before
    start = dict(fields(records(resumed.read_bytes())[1]))
    assert (start[2], start[7]) == (2, b"\x08\x01")
    assert steps_of(metrics) == [0, 1, 2, 3, 4, 5, 6]
    # The score at the end of a run stays where the run is resumed from its end.
    train(open_store(store_path), out, TINY, resume=True)
    assert steps_of(metrics) == [0, 1, 2, 3, 4, 5, 6, 6]


def test_tensorboard_keeps_the_score_of_a_run_whose_continuation_was_killed(
    store_path: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    whole = train(open_store(store_path), out, TINY)
    metrics, before = out / "metrics.jsonl", set(out.glob("events.*"))
    with metrics.open("a") as file:  # of a longer training that was killed before its first save
        file.write(json.dumps({"step": 6, "learning_rate": 1.0, "seconds": 0.5}) + "\n")
    train(open_store(store_path), out, TINY, resume=True)
    (resumed,) = set(out.glob("events.*")) - before
    _, start, earlier, later = records(resumed.read_bytes())
    assert dict(fields(start))[2] == 6
    # Of step 6 earlier files are void: the score that they have is repeated, the killed step not.
    for event in (earlier, later):
        _, step, values = scalars(event)
        assert (step, values["psnr_db"]) == (6, np.float32(whole.score.psnr_db))
        assert not {"step", "seconds", "learning_rate"} & values.keys()
    assert steps_of(metrics) == [0, 1, 2, 3, 4, 5, 6, 6]


def test_a_new_run_has_no_curves_of_one_that_ended_before_its_first_checkpoint(
    store_path: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    out.mkdir()
    (out / "metrics.jsonl").write_text('{"step": 0, "learning_rate": 0.5, "maps": 7.0}\n')
    dead = out / "events.out.tfevents.0000000001.abcd"
    dead.write_bytes(b"")
    batch = out / "stopped-0000007.safetensors"
    batch.write_bytes(b"kept, to see why that one stopped")
    train(open_store(store_path), out, TINY)
    assert steps_of(out / "metrics.jsonl") == [0, 1, 2, 3, 4, 5, 6]
    assert not dead.exists()
    assert batch.exists()


def test_a_run_is_neither_overwritten_nor_mixed(store_path: Path, tmp_path: Path) -> None:
    store = open_store(store_path)
    with pytest.raises(CheckpointError, match=r"run: found no run.*Leave --resume out"):
        train(store, tmp_path / "run", TINY, resume=True)
    run_interrupted(store_path, tmp_path / "run", TINY, 1)
    with pytest.raises(CheckpointError, match="a run that is there already"):
        train(store, tmp_path / "run", TINY)
    wide = dataclasses.replace(TINY.generator, width=16)
    changed = dataclasses.replace(TINY, learning_rate=1.0, generator=wide)
    text = "generator.width, learning_rate: found 16, 1.0 now, expected 8, 0.002, as the run began"
    with pytest.raises(CheckpointError, match=text):
        train(store, tmp_path / "run", changed, resume=True)
    many = dataclasses.replace(
        changed, beta1=0.1, beta2=0.2, epochs=2, map_weight=1.0, render_weight=1.0
    )
    with pytest.raises(CheckpointError, match=r"beta1, beta2, .* and \d more: found"):
        train(store, tmp_path / "run", many, resume=True)
    with pytest.raises(CheckpointError, match="family: found patches, as the run began"):
        train(store, tmp_path / "run", WholeTrainConfig(), resume=True)
    other = dataclasses.replace(store, fingerprint="0" * 64)
    with pytest.raises(CheckpointError, match="data_fingerprint"):
        train(other, tmp_path / "run", TINY, resume=True)


def test_a_training_that_diverges_reports_it(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverged(*given: Any) -> torch.Tensor:
        return maps_loss(*given) * torch.inf

    monkeypatch.setattr("learning.patch_train.maps_loss", diverged)
    with pytest.raises(TrainingError, match="Lower learning_rate"):
        train(open_store(store_path), tmp_path / "run", TINY)
    assert not (tmp_path / "run" / INDEX).exists()


def test_all_files_of_a_run_have_the_users_own_permissions(
    store_path: Path, tmp_path: Path
) -> None:
    before = os.umask(0o027)
    try:
        run_interrupted(store_path, tmp_path / "run", TINY, 1)
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "run").iterdir()}
    assert set(modes.values()) == {0o640}, modes
