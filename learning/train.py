"""Training on patches: generator against discriminators, with the rendering loss."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn

from learning.average import follow, moving_average
from learning.checkpoint import (
    AVERAGE,
    INDEX,
    Checkpoint,
    adam_tensors,
    fill,
    fill_adam,
    load_tensors,
    part_of,
)
from learning.clock import RENDERING, Clock
from learning.data import Batch
from learning.devices import CPU
from learning.encoding import Reflectance
from learning.forward import Forward
from learning.losses import maps_loss, rendering_loss
from learning.networks.discriminator import Discriminators, feature_loss, verdict_loss
from learning.networks.generator import IN_CHANNELS, OUT_CHANNELS, Generator, initialise
from learning.patch_run import train_patches
from learning.presets import TrainConfig
from learning.processes import ALONE, Processes
from learning.run import TrainResult
from learning.score import Score, answers_of
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store


class Trainer:
    """A generator, discriminators and their optimisers, one step at a time."""

    def __init__(
        self,
        config: TrainConfig,
        device: torch.device = CPU,
        processes: Processes = ALONE,
        in_channels: int = IN_CHANNELS,
        out_channels: int = OUT_CHANNELS,
    ) -> None:
        """Networks on a device, with random weights of the configuration's seed."""
        torch.manual_seed(config.seed)
        self.config, self.device, self.processes = config, device, processes
        self.clock = Clock()
        self.generator = Generator(config.generator, in_channels, out_channels)
        self.discriminators = Discriminators(in_channels + out_channels, config.discriminator)
        # Drawn on the processor, so that every device begins with the same weights.
        for network in self.networks():
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

    def step(self, batch: Batch, number: int = 0) -> dict[str, float]:
        """Step `number` of both; returns the losses, and the maps' unweighted L1 as `error`."""
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
        error = own * maps_loss(found, batch)
        parts = {
            "adversarial": verdict_loss(judged, True),
            "features": config.feature_weight * feature_loss(real_features, judged),
            "maps": config.map_weight * error,
        }
        if config.render_weight > 0:
            with self.clock.part(RENDERING):
                rendered = rendering_loss(found, batch, config.render_norm)
            # Over patches the norm's mean is one over patches, over texels one over texels.
            share = own if config.render_norm == "texel" else 1.0
            parts["rendering"] = share * config.render_weight * rendered
        total = torch.stack(list(parts.values())).sum()
        self._generator_adam.zero_grad(set_to_none=True)
        total.backward()
        processes.average_gradients(self.generator.parameters())
        self._generator_adam.step()
        self.discriminators.requires_grad_(True)
        if self.average is not None:
            follow(self.average, self.generator, config.ema, number)
        losses = {name: float(value.detach()) for name, value in parts.items()}
        beside = {"discriminators": judging, "error": error}
        return {**losses, **{name: float(value.detach()) for name, value in beside.items()}}

    @property
    def trained(self) -> Generator:
        """The generator to score and to infer with: the average where there is one."""
        return (self.generator if self.average is None else self.average).eval()

    def answers(self) -> Callable[[Batch], Reflectance]:
        """See `PatchTrainer`."""
        return answers_of(self.trained)

    def kept(self, batch: Batch) -> dict[str, Tensor]:
        """See `PatchTrainer`."""
        return {name: getattr(batch, name) for name in ("inputs", "target", "covered", "texture")}

    def networks(self) -> tuple[nn.Module, ...]:
        """See `PatchTrainer`."""
        return self.generator, self.discriminators

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
        saved = {role: load_tensors(checkpoint, role) for role in self.tensors()}
        self.take_over(saved, checkpoint.folder / INDEX)

    def take_over(self, saved: dict[str, dict[str, Tensor]], where: Path) -> None:
        """Take over what `tensors` gave; CheckpointError, with `where`, when it is another's."""
        with torch.no_grad():
            fill(self.generator, saved["generator"], where)
            if self.average is not None:
                fill(self.average, saved[AVERAGE], where)
            fill(self.discriminators, part_of(saved["training"], "discriminators"), where)
        fill_adam(self._generator_adam, saved["training"], "generator_adam")
        fill_adam(self._discriminator_adam, saved["training"], "discriminator_adam")


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
    draws = config.environments if config.render_weight > 0 else 0

    def make() -> Trainer:
        return Trainer(config, device, processes)

    return train_patches(store, out, config, make, draws, resume, progress, processes)
