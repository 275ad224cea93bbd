"""What all families of networks share: their configuration, and the one way in which they train."""

from __future__ import annotations

import dataclasses
import itertools
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
import torch

from learning.checkpoint import (
    load_mesostructure,
    load_super_resolution,
    load_tensors,
    load_whole_face,
    read_checkpoint,
    shipped_mesostructure,
    shipped_super_resolution,
    shipped_weights,
)
from learning.commands import trained_line
from learning.config import TrainingConfig
from learning.limits import LIMITS, require_within
from learning.network_trainer import NetworkTrainer
from learning.presets import FAMILIES
from learning.run import Run, not_better
from learning.train import TRAINERS, train
from learning.training import Task
from learning.whole.score import FaceScore
from lightstage.formats.config import as_dict, make_config
from processing.dataset import Store, open_store
from tests.learning.test_whole_face import stopping_after

CONFIGS = {config.family: config for config in FAMILIES.values()}


def test_every_preset_has_a_trainer_and_shares_one_configuration() -> None:
    assert set(CONFIGS) == set(TRAINERS)
    shared = {field.name for field in dataclasses.fields(TrainingConfig)}
    for config in CONFIGS.values():
        assert issubclass(config, TrainingConfig)
        assert shared < {field.name for field in dataclasses.fields(config)}
        assert config().held_out_subjects == 1


@pytest.mark.parametrize(
    ("folder", "load"),
    [
        (shipped_weights(), load_whole_face),
        (shipped_super_resolution(), load_super_resolution),
        (shipped_mesostructure(), load_mesostructure),
    ],
)
def test_shipped_weights_load_and_their_configuration_is_taken_as_it_stands(
    folder: Path, load: Any
) -> None:
    network, checkpoint = load(folder)
    assert sum(weight.numel() for weight in network.parameters()) > 5e4
    then = checkpoint.config
    config = make_config(CONFIGS[checkpoint.family], then, folder)
    require_within(config, folder)
    now = json.loads(json.dumps(as_dict(config)))

    def within(old: Any, new: Any) -> bool:
        if isinstance(old, dict):
            return old.keys() <= new.keys() and all(within(old[k], new[k]) for k in old)
        return bool(old == new)

    assert within(then, now)


@dataclasses.dataclass(frozen=True)
class ToneConfig(TrainingConfig):
    """A family that exists in this test alone."""

    family: ClassVar[str] = "tone"
    batch: int = 4
    learning_rate: float = 0.05
    ema: float = 0.5
    target: float = 0.7

    @property
    def held_out_subjects(self) -> int:
        return 1


@dataclasses.dataclass(frozen=True)
class Tones:
    inputs: torch.Tensor


class ToneTrainer(NetworkTrainer[ToneConfig, Tones, torch.nn.Conv2d]):
    watched = "far"

    def fresh(self) -> torch.nn.Conv2d:
        return torch.nn.Conv2d(3, 1, 1)

    def rate(self, done: float, _: int) -> float:
        return self.config.learning_rate * (1 - done)

    def losses(self, batch: Tones) -> dict[str, torch.Tensor]:
        return {"far": (self.forward(batch.inputs) - self.config.target).abs().mean()}


@dataclasses.dataclass(frozen=True)
class ToneScore:
    far: float

    def sentence(self) -> str:
        return f"{self.far:.2f} off"


def tone_task(
    trainer: ToneTrainer, store: Store, trained_on: set[str], held_out: set[str], run: Run
) -> Task[Tones, ToneScore]:
    assert not trained_on & held_out
    assert trained_on | held_out == {scan.subject for scan in store.scans}

    def draw(count: int, rng: np.random.Generator, share: slice = slice(None)) -> Tones:
        return Tones(torch.from_numpy(rng.random((count, 3, 2, 2), np.float32))[share])

    def finish() -> tuple[ToneScore, list[Any]]:
        with torch.inference_mode():
            far = trainer.trained(torch.full((1, 3, 1, 1), 0.5)) - trainer.config.target
        return ToneScore(float(far.abs())), []

    return Task(draw, 40, len(trained_on), finish)


def test_a_family_of_its_own_needs_no_more_than_a_configuration_a_trainer_and_a_task(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(TRAINERS, ToneConfig.family, (ToneTrainer, tone_task))
    store, config = open_store(store_path), ToneConfig(log_steps=1)
    # Its own number has no bounds; that every family's have is another test's.
    monkeypatch.setitem(LIMITS, "target", (0, 1))
    straight = train(store, tmp_path / "a", config)
    assert straight.steps == 40
    assert straight.held_out == ["person-2"]
    assert straight.score.far < 0.2
    assert straight.shares["idle"] > 0
    with pytest.raises(KeyboardInterrupt):
        train(store, tmp_path / "b", config, progress=stopping_after(7))
    assert train(store, tmp_path / "b", config, resume=True).score == straight.score
    first, second = (read_checkpoint(tmp_path / name) for name in "ab")
    assert first.files == second.files
    assert set(first.files) == {"network", "average", "training"}
    assert first.family == "tone"
    assert load_tensors(first, "training")["adam.0.step"] == 40
    lines = [json.loads(s) for s in (tmp_path / "a" / "metrics.jsonl").read_text().splitlines()]
    assert lines[0]["learning_rate"] == 0.05
    assert lines[20]["learning_rate"] == pytest.approx(0.025)
    assert lines[-1]["far"] == straight.score.far


def test_a_training_by_time_that_goes_on_does_not_begin_at_its_largest_rate_again(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = itertools.count()
    # Every look at the clock is a tenth of a second after the one before.
    clock = SimpleNamespace(
        monotonic=lambda: next(ticks) / 10, perf_counter=lambda: next(ticks) / 10
    )
    monkeypatch.setattr("learning.run.time", clock)
    monkeypatch.setattr("learning.clock.time", clock)
    monkeypatch.setitem(TRAINERS, ToneConfig.family, (ToneTrainer, tone_task))
    monkeypatch.setitem(LIMITS, "target", (0, 1))
    store, out = open_store(store_path), tmp_path / "run"
    begun = train(store, out, ToneConfig(log_steps=1, seconds=20.0))
    spent = read_checkpoint(out).step_seconds
    # The first step, which compiles loops, is no part of a budget.
    assert begun.step_seconds - 1 < spent < begun.step_seconds
    # What is written on the way may be another: it changes no step.
    longer = ToneConfig(log_steps=2, seconds=10.0, save_seconds=7.0)
    found = train(store, out, longer, resume=True)
    assert found.first == begun.steps < found.steps
    more = read_checkpoint(out).step_seconds - spent
    assert found.step_seconds - 1 < more < found.step_seconds
    lines = [json.loads(text) for text in (out / "metrics.jsonl").read_text().splitlines()]
    resumed = [line for line in lines if line["step"] >= begun.steps and "learning_rate" in line]
    rates = [line["learning_rate"] for line in resumed]
    # The share past is that of both calls together, less the look or two before the first step.
    assert rates[0] == pytest.approx(0.05 * 10 / (spent + 10), rel=0.05)
    assert rates == sorted(rates, reverse=True)


def test_a_network_that_a_plain_guess_is_as_good_as_is_reported() -> None:
    score = FaceScore(*[0.0] * len(dataclasses.fields(FaceScore)))
    known = {"psnr_db": 18.0, "psnr_input_db": 9.0, "psnr_mean_db": 18.58}
    warning = not_better(dataclasses.replace(score, **known))
    assert "18.00 dB are no better than the mean person (18.58 dB)" in warning
    assert "lower learning_rate" in warning
    assert not_better(dataclasses.replace(score, **{**known, "psnr_db": 18.59})) == ""


def test_the_last_line_names_which_steps_and_seconds_are_of_this_call() -> None:
    facts = {
        "steps": 265, "steps_of_earlier_calls": 219, "seconds": 59.4, "step_seconds": 20.2,
        "scored": "diffuse albedo", "held_out": "P9", "said": "PSNR 22.50 dB", "device": "cpu",
        "share_data": 0.09, "share_rendering": 0.76, "share_network": 0.67, "share_idle": 0.33,
    }  # fmt: skip
    line = trained_line(facts)
    assert line.startswith("265 steps (46 of them in this call); 20 s of steps in 59 s with ")
    assert "the network took 67 %, waiting for batches 33 %; making batches, much of it" in line
    assert trained_line({**facts, "steps_of_earlier_calls": 0}).startswith("265 steps; 20 s")
    assert trained_line({**facts, "steps": 219}).endswith("PSNR 22.50 dB")


def test_a_network_of_detail_states_the_rows_that_it_was_shown() -> None:
    shown = {name: cls().rows_shown(6144) for name, cls in FAMILIES.items()}
    assert shown["mesostructure"] == shown["rcan"] == 1536
    assert shown["paper"] == shown["modern"] == 6144
    assert all(cls().rows_shown(384) == 384 for cls in FAMILIES.values())
