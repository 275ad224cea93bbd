"""A training that goes astray stops, and the batch at which it did is kept."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import load_file

from learning.augment import AugmentConfig
from learning.checkpoint import load_tensors, read_checkpoint
from learning.errors import TrainingError
from learning.guard import Guard
from learning.networks.whole_face import WholeFaceConfig
from learning.render.environments import RandomLightConfig
from learning.run import Run
from learning.training import BatchLearner
from learning.whole.config import WholeTrainConfig
from learning.whole.faces import Faces, FacesConfig
from learning.whole.train import WholeFaceTrainer
from processing.dataset import open_store

SIZE = WholeFaceConfig(rows=48, columns=32, width=4, halvings=2)


def first_leap(losses: np.ndarray) -> int | None:
    guard = Guard()
    return next((step for step, loss in enumerate(losses) if guard.leapt(float(loss))), None)


@given(st.integers(0, 10**6), st.floats(1e-6, 1e6), st.floats(0.0, 1.0))
def test_noise_of_batches_while_a_loss_falls_or_rests_is_no_leap(
    seed: int, scale: float, fall: float
) -> None:
    noise = np.random.default_rng(seed).lognormal(sigma=0.6, size=600)
    losses = scale * noise * np.exp(-3 * fall * np.linspace(0, 1, 600))
    assert first_leap(losses) is None


@given(st.integers(0, 10**6), st.floats(1e-6, 1e6), st.integers(4, 300))
def test_a_loss_that_rises_tenfold_and_stays_is_found_within_fifty_steps(
    seed: int, scale: float, when: int
) -> None:
    losses = scale * np.random.default_rng(seed).lognormal(sigma=0.3, size=when + 60)
    losses[when:] *= 10
    found = first_leap(losses)
    assert found is not None
    assert when <= found < when + 50


def test_a_rate_that_spoils_all_steps_but_the_first_is_found_after_fifty() -> None:
    """As 250 times the learning rate of whole faces does, which begin with the mean person."""
    losses = np.r_[0.016, np.random.default_rng(0).uniform(0.19, 0.33, 121)]
    assert first_leap(losses) == 49
    assert first_leap(np.r_[0.03, losses[1:]]) is None


class Astray:
    """A network whose loss is `losses[number]`."""

    watched: ClassVar[str] = "diffuse"

    def __init__(self, losses: list[float]) -> None:
        self.losses = losses

    def step(self, number: int, _: float) -> dict[str, float]:
        return {"learning_rate": 0.1, "diffuse": self.losses[number]}

    def batch(self, number: int) -> dict[str, torch.Tensor]:
        return {"inputs": torch.full((2, 3), float(number))}

    def tensors(self) -> dict[str, dict[str, torch.Tensor]]:
        return {"network": {}, "training": {}}


@pytest.mark.parametrize(
    ("losses", "at", "message"),
    [
        ([1.0] * 60 + [20.0] * 60, 70, "found diffuse 5 times its lowest mean of 50 steps"),
        ([1.0] * 7 + [math.nan], 7, "found losses .*nan"),
        ([1.0] * 4 + [9.0] * 90, 49, "found diffuse 5 times"),
    ],
)
def test_a_training_that_goes_astray_stops_and_keeps_the_batch(
    tmp_path: Path, losses: list[float], at: int, message: str
) -> None:
    run = Run(tmp_path / "run", WholeTrainConfig(), {"held_out": []}, 0, 0.0)
    with pytest.raises(
        TrainingError, match=rf"step {at}: {message}.* Lower learning_rate"
    ) as caught:
        run.steps(Astray(losses), len(losses))
    kept = tmp_path / "run" / f"stopped-{at:07d}.safetensors"
    assert kept.name in str(caught.value)
    assert load_file(kept)["inputs"].mean() == at


ABOUT = {
    "held_out": [],
    "config": {},
    "data_fingerprint": "",
    "texture_rows": 96,
    "metrics": {},
}


def test_a_checkpoint_of_the_first_step_does_not_count_what_that_took_to_compile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Else a training by time that is killed then has no time left when it is resumed.
    now = [0.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], perf_counter=lambda: now[0])
    monkeypatch.setattr("learning.run.time", clock)
    monkeypatch.setattr("learning.clock.time", clock)
    kept = []

    class Slow(Astray):
        def step(self, number: int, done: float) -> dict[str, float]:
            now[0] += 1.0 if number else 170.0
            return super().step(number, done)

    def look(_: int, __: int) -> None:
        kept.append(read_checkpoint(tmp_path / "run").step_seconds)

    Run(tmp_path / "run", WholeTrainConfig(save_seconds=0), ABOUT, 0, 0.0).steps(
        Slow([1.0] * 3), 3, look
    )
    assert kept == [0.0, 1.0, 2.0]


class Spoilt(Astray):
    """A network whose weights are NaN from a step on, whose loss is finite."""

    def __init__(self, spoilt_at: int) -> None:
        super().__init__([1.0] * 20)
        self.taken, self.spoilt_at = 0, spoilt_at

    def step(self, number: int, done: float) -> dict[str, float]:
        self.taken = number
        return super().step(number, done)

    def tensors(self) -> dict[str, dict[str, torch.Tensor]]:
        value = math.nan if self.taken >= self.spoilt_at else float(self.taken)
        weights = {"count": torch.tensor(3), "weight": torch.full((2,), value)}
        return {"network": {"weight": torch.zeros(2)}, "training": weights}


def test_weights_that_are_nan_never_replace_the_last_whole_checkpoint(tmp_path: Path) -> None:
    out = tmp_path / "run"
    run = Run(out, WholeTrainConfig(save_seconds=0), ABOUT, 0, 0.0)
    with pytest.raises(TrainingError, match=r"step 6: found NaN .* in training, weight, .* kept"):
        run.steps(Spoilt(6), 20)
    checkpoint = read_checkpoint(out)
    assert checkpoint.step == 6
    assert load_tensors(checkpoint, "training")["weight"].tolist() == [5.0, 5.0]


def test_the_batch_that_is_kept_is_the_one_that_was_trained_on(store_path: Path) -> None:
    store = open_store(store_path)
    people = {scan.subject for scan in store.scans}
    faces = Faces(
        store,
        people,
        SIZE,
        FacesConfig(shadow_sets=3),
        RandomLightConfig(),
        AugmentConfig(),
        np.random.default_rng(0),
    )
    trainer = WholeFaceTrainer(WholeTrainConfig(network=SIZE))
    seen: list[torch.Tensor] = []
    step = trainer.step
    trainer.step = lambda batch, *rest: (seen.append(batch.inputs), step(batch, *rest))[1]  # type: ignore[method-assign]
    learner = BatchLearner(trainer, faces.draw)
    learner.step(11, 0.5)
    assert torch.equal(learner.batch(11)["inputs"], seen[0])
    assert not torch.equal(learner.batch(12)["inputs"], seen[0])
