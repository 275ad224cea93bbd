"""Training of the `avatarme` preset: four networks, each against discriminators of its own."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import ClassVar

import numpy as np
from torch import Tensor

from learning.checkpoint import INDEX, Checkpoint, load_tensors, part_of
from learning.data import Batch, PatchData
from learning.four.channels import PARTS, pairs
from learning.four.config import FourTrainConfig
from learning.four.networks import FourNetworks
from learning.limits import require_within
from learning.presets import TrainConfig
from learning.run import TrainResult, begin, split
from learning.score import Score, score_answers
from learning.train import Trainer
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store

GENERATORS, TRAINING = "generators", "training"
"""Roles of a checkpoint's files."""


def config_of_part(config: FourTrainConfig, index: int) -> TrainConfig:
    """One network's training: as a single network's without the rendering loss."""
    shared = {
        field.name: getattr(config, field.name)
        for field in dataclasses.fields(FourTrainConfig)
        if field.name != "seed"
    }
    # Networks of one size must not begin with the same weights.
    return TrainConfig(**shared, seed=4 * config.seed + index, render_weight=0.0)


class FourTrainer:
    """Four networks with their discriminators and optimisers."""

    def __init__(self, config: FourTrainConfig) -> None:
        """Random weights of the configuration's seed."""
        self.config = config
        self.trainers = {
            part: Trainer(config_of_part(config, index), inputs, channels.stop - channels.start)
            for index, (part, (inputs, channels)) in enumerate(PARTS.items())
        }
        self.networks = FourNetworks({p: t.generator for p, t in self.trainers.items()})

    def step(self, batch: Batch, done: float) -> dict[str, float]:
        """One step of all of a training of which the share `done` is past; the losses by part."""
        losses: dict[str, float] = {}
        for part, pair in pairs(batch).items():
            trainer = self.trainers[part]
            losses["learning_rate"] = trainer.set_rate(done)
            said = trainer.step(pair)
            # The next network's step needs the room: at full width 0.7 GB.
            trainer.generator.zero_grad(set_to_none=True)
            losses |= {f"{part}.{name}": value for name, value in said.items()}
        return {**losses, "error": sum(losses[f"{part}.error"] for part in PARTS)}

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""
        return {
            GENERATORS: dict(self.networks.state_dict()),
            TRAINING: {
                f"{part}.{name}": value
                for part, trainer in self.trainers.items()
                for name, value in trainer.tensors()["training"].items()
            },
        }

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""
        generators = load_tensors(checkpoint, GENERATORS)
        training = load_tensors(checkpoint, TRAINING)
        for part, trainer in self.trainers.items():
            own = {"generator": part_of(generators, part), "training": part_of(training, part)}
            trainer.take_over(own, checkpoint.folder / INDEX)


class FourLearner:
    """The four networks, fed with random patches."""

    watched: ClassVar[str] = "error"

    def __init__(self, trainer: FourTrainer, data: PatchData) -> None:
        """Train `trainer` on `data`."""
        self._trainer, self._data = trainer, data

    def step(self, number: int, done: float) -> dict[str, float]:
        """See `Learner`."""
        return self._trainer.step(self._drawn(number), done)

    def batch(self, number: int) -> dict[str, Tensor]:
        """See `Learner`."""
        drawn = pairs(self._drawn(number))
        kept = {f"{part}.inputs": pair.inputs for part, pair in drawn.items()}
        return kept | {f"{part}.target": pair.target for part, pair in drawn.items()}

    def _drawn(self, number: int) -> Batch:
        config = self._trainer.config
        return self._data.draw(config.batch, np.random.default_rng([config.seed, 2, number]))

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Learner`."""
        return self._trainer.tensors()


def train_four(
    store: Store,
    out: Path,
    config: FourTrainConfig,
    resume: bool = False,
    progress: ProgressCallback = quiet,
) -> TrainResult[Score]:
    """Train four networks; arguments, errors and what is left in `out` as `learning.train.train`.

    They are scored as they are used: each on what those before it found.
    """
    require_within(config, "training")
    held_out, trained_on = split(store, config.data.held_out_subjects)
    trainer = FourTrainer(config)
    run = begin(out, config, store, held_out, resume, trainer.load)
    rng = np.random.default_rng([config.seed, 1])
    parts = (config.data, config.lights, config.augment)
    data = PatchData(store, trained_on, *parts, rng, config.shading, seed=config.seed)
    scored = PatchData(store, held_out, *parts, rng, config.shading, seed=config.seed)
    learner = FourLearner(trainer, data)
    total = max(1, math.ceil(config.epochs * len(data.places) / config.batch))
    steps = run.steps(learner, total, progress)
    trainer.networks.eval()
    result = score_answers(trainer.networks.said, scored, data, config.score_patches, config.seed)
    return run.end(learner, steps, len(data.places), result)
