"""Training of the `avatarme` preset: four networks, each against discriminators of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn

from learning.checkpoint import AVERAGE, part_of
from learning.data import Batch
from learning.devices import CPU
from learning.encoding import Reflectance
from learning.four.channels import PARTS, pairs
from learning.four.config import FourTrainConfig
from learning.four.networks import FourNetworks
from learning.patch_config import TrainConfig
from learning.patch_train import PatchTrainer
from learning.processes import ALONE, Processes
from learning.training import Trainer

GENERATORS, TRAINING = "generators", "training"
"""Roles of a checkpoint's files, beside that of the average."""


def config_of_part(config: FourTrainConfig, index: int) -> TrainConfig:
    """One network's training: as a single network's without the rendering loss."""
    shared = {
        field.name: getattr(config, field.name)
        for field in dataclasses.fields(FourTrainConfig)
        if field.name != "seed"
    }
    # Networks of one size must not begin with the same weights.
    return TrainConfig(**shared, seed=(4 * config.seed + index) % 2**63, render_weight=0.0)


class FourTrainer(Trainer[FourTrainConfig, Batch]):
    """Four networks with their discriminators and optimisers."""

    watched = "error"
    role = GENERATORS

    def __init__(
        self,
        config: FourTrainConfig,
        device: torch.device = CPU,
        processes: Processes = ALONE,
    ) -> None:
        """Networks on a device, each with random weights of its own."""
        super().__init__(config, device, processes)
        self.trainers = {
            part: PatchTrainer(
                config_of_part(config, index),
                device,
                processes,
                inputs,
                channels.stop - channels.start,
            )
            for index, (part, (inputs, channels)) in enumerate(PARTS.items())
        }

    @property
    def trained(self) -> FourNetworks:
        """The networks to score and to infer with: the averages where there are some."""
        return FourNetworks({part: trainer.trained for part, trainer in self.trainers.items()})

    def answers(self) -> Callable[[Batch], Reflectance]:
        """What the networks find on patches, each given what those before it found."""
        return self.trained.answers

    def set_rate(self, done: float, _: int = 0) -> float:
        """See `Trainer`."""
        return max(trainer.set_rate(done) for trainer in self.trainers.values())

    def step(self, batch: Batch, number: int = 0) -> dict[str, float]:
        """Step `number` of all; the losses by part, and the sum of their errors as `error`."""
        losses: dict[str, float] = {}
        for part, pair in pairs(batch).items():
            trainer = self.trainers[part]
            part_losses = trainer.step(pair, number)
            # The next network's step needs the room: at full width 0.7 GB.
            trainer.generator.zero_grad(set_to_none=True)
            losses |= {f"{part}.{name}": value for name, value in part_losses.items()}
        return {**losses, "error": sum(losses[f"{part}.error"] for part in PARTS)}

    def batch_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """See `Trainer`."""
        drawn = pairs(batch)
        kept = {f"{part}.inputs": pair.inputs for part, pair in drawn.items()}
        return kept | {f"{part}.target": pair.target for part, pair in drawn.items()}

    def networks(self) -> list[nn.Module]:
        """See `Trainer`."""
        return [network for trainer in self.trainers.values() for network in trainer.networks()]

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Trainer`."""
        each = {part: trainer.tensors() for part, trainer in self.trainers.items()}
        roles = {"generator": GENERATORS, TRAINING: TRAINING}
        if self.config.ema:
            roles[AVERAGE] = AVERAGE
        return {
            role: {
                f"{part}.{name}": value
                for part, state in each.items()
                for name, value in state[own].items()
            }
            for own, role in roles.items()
        }

    def begin_with(self, weights: dict[str, Tensor], where: Path) -> None:
        """See `Trainer`."""
        for part, trainer in self.trainers.items():
            trainer.begin_with(part_of(weights, part), where)

    def take_over(self, saved: dict[str, dict[str, Tensor]], where: Path) -> None:
        """See `Trainer`."""
        roles = {**saved, "generator": saved[GENERATORS]}
        for part, trainer in self.trainers.items():
            own = {role: part_of(tensors, part) for role, tensors in roles.items()}
            trainer.take_over(own, where)
