"""Training on patches: generator against discriminators, with the rendering loss."""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from learning.checkpoint import (
    INDEX,
    Checkpoint,
    adam_tensors,
    fill,
    fill_adam,
    load_tensors,
    part_of,
)
from learning.data import Batch, PatchData
from learning.limits import require_within
from learning.losses import maps_loss, rendering_loss
from learning.networks.discriminator import Discriminators, feature_loss, verdict_loss
from learning.networks.generator import IN_CHANNELS, OUT_CHANNELS, Generator, initialise
from learning.presets import TrainConfig
from learning.run import TrainResult, begin, split
from learning.score import Score, score
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store


class Trainer:
    """Networks and optimisers, one step at a time."""

    def __init__(
        self,
        config: TrainConfig,
        in_channels: int = IN_CHANNELS,
        out_channels: int = OUT_CHANNELS,
    ) -> None:
        """Networks with random weights of the configuration's seed."""
        torch.manual_seed(config.seed)
        self.config = config
        self.generator = Generator(config.generator, in_channels, out_channels)
        self.discriminators = Discriminators(in_channels + out_channels, config.discriminator)
        initialise(self.generator)
        initialise(self.discriminators)
        betas = (config.beta1, config.beta2)
        self._generator_adam = torch.optim.Adam(
            self.generator.parameters(), config.learning_rate, betas
        )
        self._discriminator_adam = torch.optim.Adam(
            self.discriminators.parameters(), config.learning_rate, betas
        )

    def set_rate(self, done: float) -> float:
        """Set the learning rate for a training that is `done` (0..1); returns it."""
        constant = self.config.constant_share
        left = min(1.0, (1 - done) / max(1e-9, 1 - constant))
        rate = self.config.learning_rate * max(0.0, left)
        for optimiser in (self._generator_adam, self._discriminator_adam):
            for group in optimiser.param_groups:
                group["lr"] = rate
        return rate

    def step(self, batch: Batch) -> dict[str, float]:
        """One step of both; returns the losses, and the maps' unweighted L1 as `error`."""
        config = self.config
        found = self.generator(batch.inputs) * batch.covered_channels
        real_pair = torch.cat([batch.inputs, batch.target], dim=1)
        judged_real = self.discriminators(real_pair)
        judged_fake = self.discriminators(torch.cat([batch.inputs, found.detach()], dim=1))
        # Halved, so that the discriminators learn at half the generator's pace [Wang2018].
        judging = 0.5 * (verdict_loss(judged_fake, False) + verdict_loss(judged_real, True))
        self._discriminator_adam.zero_grad(set_to_none=True)
        judging.backward()
        self._discriminator_adam.step()

        self.discriminators.requires_grad_(False)
        judged = self.discriminators(torch.cat([batch.inputs, found], dim=1))
        # By the discriminators as they are now, as the fake pair is judged: features of those of
        # before the step would differ even where the generator is right.
        with torch.no_grad():
            real_features = self.discriminators(real_pair)
        error = maps_loss(found, batch)
        parts = {
            "adversarial": verdict_loss(judged, True),
            "features": config.feature_weight * feature_loss(real_features, judged),
            "maps": config.map_weight * error,
        }
        if config.render_weight > 0:
            rendered = rendering_loss(found, batch, config.render_norm)
            parts["rendering"] = config.render_weight * rendered
        total = torch.stack(list(parts.values())).sum()
        self._generator_adam.zero_grad(set_to_none=True)
        total.backward()
        self._generator_adam.step()
        self.discriminators.requires_grad_(True)
        losses = {name: float(value.detach()) for name, value in parts.items()}
        beside = {"discriminators": judging, "error": error}
        return {**losses, **{name: float(value.detach()) for name, value in beside.items()}}

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""
        return {
            "generator": dict(self.generator.state_dict()),
            "training": {
                **{f"discriminators.{k}": v for k, v in self.discriminators.state_dict().items()},
                **adam_tensors(self._generator_adam, "generator_adam"),
                **adam_tensors(self._discriminator_adam, "discriminator_adam"),
            },
        }

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""
        saved = {role: load_tensors(checkpoint, role) for role in ("generator", "training")}
        self.take_over(saved, checkpoint.folder / INDEX)

    def take_over(self, saved: dict[str, dict[str, Tensor]], where: Path) -> None:
        """Take over what `tensors` gave; CheckpointError, with `where`, when it is another's."""
        with torch.no_grad():
            fill(self.generator, saved["generator"], where)
            fill(self.discriminators, part_of(saved["training"], "discriminators"), where)
        fill_adam(self._generator_adam, saved["training"], "generator_adam")
        fill_adam(self._discriminator_adam, saved["training"], "discriminator_adam")


class PatchLearner:
    """The networks, fed with random patches."""

    watched: ClassVar[str] = "error"

    def __init__(self, trainer: Trainer, data: PatchData) -> None:
        """Train `trainer` on `data`."""
        self._trainer, self._data = trainer, data

    def step(self, number: int, done: float) -> dict[str, float]:
        """See `Learner`."""
        rate = self._trainer.set_rate(done)
        return {"learning_rate": rate, **self._trainer.step(self._drawn(number))}

    def batch(self, number: int) -> dict[str, Tensor]:
        """See `Learner`."""
        drawn = self._drawn(number)
        return {name: getattr(drawn, name) for name in ("inputs", "target", "covered", "texture")}

    def _drawn(self, number: int) -> Batch:
        config = self._trainer.config
        return self._data.draw(config.batch, np.random.default_rng([config.seed, 2, number]))

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Learner`."""
        return self._trainer.tensors()


def train(
    store: Store,
    out: Path,
    config: TrainConfig,
    resume: bool = False,
    progress: ProgressCallback = quiet,
) -> TrainResult[Score]:
    """Train, score on the people held out, leave a checkpoint and metrics.jsonl in `out`.

    Every step draws its randomness from the seed and its own number, so a training that was
    interrupted and resumed goes on as if it had not been. Interrupting saves a checkpoint first.

    Args:
        store: the data.
        out: the run's folder.
        config: everything else.
        resume: go on from the checkpoint in `out`.
        progress: called with steps, or seconds where the time is given.

    Raises:
        TrainingError: too few people or patches, or losses that are not finite.
        CheckpointError: nothing to resume, another configuration or other data; or, without
            `resume`, a run that is there already.
    """
    require_within(config, "training")
    held_out, trained_on = split(store, config.data.held_out_subjects)
    trainer = Trainer(config)
    run = begin(out, config, store, held_out, resume, trainer.load)
    rng = np.random.default_rng([config.seed, 1])
    parts = (config.data, config.lights, config.augment)
    shading, seed = config.shading, config.seed
    draws = config.environments if config.render_weight > 0 else 0
    data = PatchData(store, trained_on, *parts, rng, shading, draws=draws, seed=seed)
    scored = PatchData(store, held_out, *parts, rng, shading, seed=seed)
    learner = PatchLearner(trainer, data)
    total = max(1, math.ceil(config.epochs * len(data.places) / config.batch))
    steps = run.steps(learner, total, progress)
    trainer.generator.eval()
    result = score(trainer.generator, scored, data, config.score_patches, config.seed)
    return run.end(learner, steps, len(data.places), result)
