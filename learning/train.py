"""Training on patches: generator against discriminators, with the rendering loss."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from learning.average import follow, moving_average
from learning.checkpoint import (
    AVERAGE,
    INDEX,
    Checkpoint,
    adam_tensors,
    fill,
    fill_adam,
    load_tensors,
)
from learning.clock import IDLE, RENDERING, Clock
from learning.data import Batch, PatchData
from learning.devices import CPU, device_of, moved
from learning.encoding import decode_maps
from learning.forward import Forward
from learning.limits import require_within
from learning.loader import Ahead, threads_may_render
from learning.losses import maps_loss, rendering_loss
from learning.networks.discriminator import Discriminators, feature_loss, verdict_loss
from learning.networks.generator import IN_CHANNELS, OUT_CHANNELS, Generator, initialise
from learning.presets import TrainConfig
from learning.processes import ALONE, Processes
from learning.run import TrainResult, begin, split
from learning.samples import MOST, Sample
from learning.score import Score, score
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store


class Trainer:
    """Networks and optimisers, one step at a time."""

    def __init__(
        self,
        config: TrainConfig,
        device: torch.device = CPU,
        processes: Processes = ALONE,
    ) -> None:
        """Networks on a device, with random weights of the configuration's seed."""
        torch.manual_seed(config.seed)
        self.config, self.processes, self.clock = config, processes, Clock()
        self.generator = Generator(config.generator)
        self.discriminators = Discriminators(IN_CHANNELS + OUT_CHANNELS, config.discriminator)
        # Drawn on the processor, so that every device begins with the same weights.
        for network in (self.generator, self.discriminators):
            initialise(network)
            network.to(device)
        self.discriminators.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = moving_average(self.generator) if config.ema else None
        self._generate: Forward[Tensor] = Forward(self.generator, device, config)
        # Compiled they would be compiled anew for each of the ways in which they are called.
        uncompiled = dataclasses.replace(config, compile="off")
        self._judge: Forward[list[list[Tensor]]] = Forward(self.discriminators, device, uncompiled)
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

    def step(
        self,
        batch: Batch,
        rng: np.random.Generator | Sequence[np.random.Generator],
        number: int = 0,
    ) -> dict[str, float]:
        """Step `number` of both; returns the losses. `rng`: see `rendering_loss`."""
        config, processes = self.config, self.processes
        if processes.count > 1:
            (texel_mm,) = processes.mean([batch.skin.texel_mm])
            batch = dataclasses.replace(
                batch, skin=dataclasses.replace(batch.skin, texel_mm=texel_mm)
            )
        # Of this process's covered texels; patches are as many in each process.
        own = processes.weight(batch.covered.sum())
        found = self._generate(batch.inputs) * batch.covered_channels
        real_pair = torch.cat([batch.inputs, batch.target], dim=1)
        judged_real = self._judge(real_pair)
        judged_fake = self._judge(torch.cat([batch.inputs, found.detach()], dim=1))
        # Halved, so that the discriminators learn at half the generator's pace [Wang2018].
        judging = 0.5 * (verdict_loss(judged_fake, False) + verdict_loss(judged_real, True))
        self._discriminator_adam.zero_grad(set_to_none=True)
        judging.backward()
        processes.average_gradients(self.discriminators.parameters())
        self._discriminator_adam.step()

        self.discriminators.requires_grad_(False)
        judged = self._judge(torch.cat([batch.inputs, found], dim=1))
        # By the discriminators as they are now, as the fake pair is judged: features of those of
        # before the step would differ even where the generator is right.
        with torch.no_grad():
            real_features = self._judge(real_pair)
        parts = {
            "adversarial": verdict_loss(judged, True),
            "features": config.feature_weight * feature_loss(real_features, judged),
            "maps": own * config.map_weight * maps_loss(found, batch),
        }
        if config.render_weight > 0:
            with self.clock.part(RENDERING):
                rendered = rendering_loss(found, batch, config.environments, config.lights, rng)
            parts["rendering"] = own * config.render_weight * rendered
        total = torch.stack(list(parts.values())).sum()
        self._generator_adam.zero_grad(set_to_none=True)
        total.backward()
        processes.average_gradients(self.generator.parameters())
        self._generator_adam.step()
        self.discriminators.requires_grad_(True)
        if self.average is not None:
            follow(self.average, self.generator, config.ema, number)
        losses = {name: float(value.detach()) for name, value in parts.items()}
        return {**losses, "discriminators": float(judging.detach())}

    @property
    def trained(self) -> Generator:
        """The generator to score and to infer with: the average where there is one."""
        return (self.generator if self.average is None else self.average).eval()

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""
        state = {
            "generator": dict(self.generator.state_dict()),
            "training": {
                **{f"discriminators.{k}": v for k, v in self.discriminators.state_dict().items()},
                **adam_tensors(self._generator_adam, "generator_adam"),
                **adam_tensors(self._discriminator_adam, "discriminator_adam"),
            },
        }
        if self.average is not None:
            state[AVERAGE] = dict(self.average.state_dict())
        return state

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""
        where = checkpoint.folder / INDEX
        with torch.no_grad():
            saved = load_tensors(checkpoint, "training")
            fill(self.generator, load_tensors(checkpoint, "generator"), where)
            if self.average is not None:
                fill(self.average, load_tensors(checkpoint, AVERAGE), where)
            prefix = "discriminators."
            own = {k[len(prefix) :]: v for k, v in saved.items() if k.startswith(prefix)}
            fill(self.discriminators, own, where)
        fill_adam(self._generator_adam, saved, "generator_adam")
        fill_adam(self._discriminator_adam, saved, "discriminator_adam")


Made = tuple[Batch, list[np.random.Generator]]
"""Patches, and each one's randomness for the rendering loss."""


class PatchLearner:
    """The networks, fed with random patches, made in a thread of their own once it is `ahead`."""

    watched: ClassVar[str] = "maps"

    def __init__(self, trainer: Trainer, data: PatchData) -> None:
        """Train `trainer` on `data`; its clock counts what a step waits for its batch."""
        self._trainer, self._data = trainer, data
        self._device = device_of(trainer.generator)
        self._batches: Ahead[Made] | None = None

    @contextlib.contextmanager
    def ahead(self) -> Iterator[None]:
        """Within the block each step's batch is made while the networks take the one before."""
        with Ahead(self._own_share) as self._batches:
            yield
        self._batches = None

    def step(self, number: int, done: float) -> dict[str, float]:
        """See `Learner`."""
        rate = self._trainer.set_rate(done)
        # On a processor the rendering loss uses the compiled renderer too.
        together = self._device != CPU or threads_may_render()
        with self._trainer.clock.part(IDLE):
            if self._batches is not None and together:
                batch, rngs = self._batches.get(number)
            else:
                batch, rngs = self._own_share(number)
        losses = self._trainer.step(moved(batch, self._device), rngs, number)
        return {"learning_rate": rate, **losses}

    def batch(self, number: int) -> dict[str, Tensor]:
        """See `Learner`."""
        aside = None if self._batches is None else self._batches.aside
        drawn, _ = self._drawn(number) if aside is None else aside(self._drawn, number)
        return {name: getattr(drawn, name) for name in ("inputs", "target", "covered", "texture")}

    def _own_share(self, number: int) -> Made:
        return self._drawn(number, self._trainer.processes.share(self._trainer.config.batch))

    def _drawn(self, number: int, share: slice = slice(None)) -> Made:
        rng, count = self._rng(number), self._trainer.config.batch
        batch = self._data.draw(count, rng, share)
        return batch, rng.spawn(count)[share]

    def _rng(self, number: int) -> np.random.Generator:
        return np.random.default_rng([self._trainer.config.seed, 2, number])

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Learner`."""
        return self._trainer.tensors()


def train(
    store: Store,
    out: Path,
    config: TrainConfig,
    resume: bool = False,
    progress: ProgressCallback = quiet,
    device: torch.device = CPU,
    processes: Processes = ALONE,
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
        device: where the networks run; what they are fed with is made on the processor.
        processes: that train together, of which this is one. The batch is that of all of them.

    Raises:
        TrainingError: too few people or patches, or losses that are not finite.
        CheckpointError: nothing to resume, another configuration or other data; or, without
            `resume`, a run that is there already.
    """
    require_within(config, "training")
    held_out, trained_on = split(store, config.data.held_out_subjects)
    processes.share(config.batch)
    trainer = Trainer(config, device, processes)
    run = begin(out, config, store, held_out, resume, trainer.load, processes)
    for network in (trainer.generator, trainer.discriminators):
        processes.same_tensors(network.state_dict().values())
    rng = np.random.default_rng([config.seed, 1])
    parts = (config.data, config.lights, config.augment)
    trainer.clock = run.clock
    data = PatchData(store, trained_on, *parts, rng, config.shading, clock=run.clock)
    scored = PatchData(store, held_out, *parts, rng, config.shading)
    learner = PatchLearner(trainer, data)
    total = max(1, math.ceil(config.epochs * len(data.places) / config.batch))
    with learner.ahead():
        steps = run.steps(learner, total, progress)
    result = score(trainer.trained, scored, data, config.score_patches, config.seed)
    samples = _samples(trainer.trained, scored, store, config.seed)
    return run.end(learner, steps, len(data.places), result, samples)


def _samples(generator: Generator, held_out: PatchData, store: Store, seed: int) -> list[Sample]:
    """Patches from over the people held out, and what the generator makes of them."""
    rng = np.random.default_rng([seed, 5])
    count = min(MOST, len(held_out.places))
    found = []
    for index in np.linspace(0, len(held_out.places) - 1, count).round().astype(int):
        batch = held_out.batch([held_out.places[index]], rng)
        with torch.inference_mode():
            said = generator(batch.inputs.to(device_of(generator))).to(CPU)
        albedo = decode_maps(said, batch.reference).diffuse_albedo
        name = store.scans[batch.places[0][0]].subject
        found.append(
            Sample(
                name,
                batch.texture,
                albedo * batch.covered,
                batch.skin.diffuse_albedo * batch.covered,
            )
        )
    return found
