"""Training of the mesostructure network: squared errors of tilts and of shading."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from torch import Tensor

from learning.augment import AugmentConfig
from learning.losses import masked_mean
from learning.mesostructure.config import LitPatchesConfig, MesostructureTrainConfig
from learning.mesostructure.data import LitPatches, PatchPool
from learning.mesostructure.network import Mesostructure
from learning.mesostructure.score import MesostructureScore, score_patches
from learning.network_trainer import NetworkTrainer
from learning.run import Run
from learning.samples import Sample
from learning.training import Task
from processing.dataset import Store

WARM_UP_STEPS = 50
"""Steps in which the rate rises, as Adam's means of gradients settle."""


class MesostructureTrainer(NetworkTrainer[MesostructureTrainConfig, LitPatches, Mesostructure]):
    """The network and its optimiser."""

    watched = "diffuse_tilt"

    def fresh(self) -> Mesostructure:
        """See `NetworkTrainer`."""
        return Mesostructure(self.config.network)

    def rate(self, done: float, number: int) -> float:
        """It rises in the first steps and falls as a cosine."""
        rate = self.config.learning_rate * min(1.0, (number + 1) / WARM_UP_STEPS)
        return rate * (0.5 + 0.5 * math.cos(math.pi * min(1.0, done)))

    def losses(self, batch: LitPatches) -> dict[str, Tensor]:
        """Mean squares over skin."""
        square = (self.forward(batch.inputs) - batch.target).square()
        losses = {
            "diffuse_tilt": masked_mean(square[:, :2], batch.weight),
            "specular_tilt": masked_mean(square[:, 2:4], batch.weight),
            "shading": masked_mean(square[:, 4:], batch.weight),
        }
        if self.processes.count > 1:
            own = self.processes.weight(batch.weight.sum())
            losses = {name: own * value for name, value in losses.items()}
        return losses

    def weights(self) -> dict[str, float]:
        """See `NetworkTrainer`."""
        return {"shading": self.config.shading_weight}


def mesostructure_task(
    trainer: MesostructureTrainer, store: Store, trained_on: set[str], held_out: set[str], _: Run
) -> Task[LitPatches, MesostructureScore]:
    """Random patches; the people held out, as they are, are scored at the end (see `TRAINERS`)."""
    config = trainer.config
    rng = np.random.default_rng([config.seed, 1])

    def pool_of(people: set[str], patches: LitPatchesConfig, skins: AugmentConfig) -> PatchPool:
        return PatchPool(store, people, patches, config.lights, skins, rng, config.shading)

    pool = pool_of(trained_on, config.patches, config.augment)
    scans = sum(scan.subject in held_out for scan in store.scans)
    as_they_are = dataclasses.replace(
        config.patches, textures=config.score_lights * scans, contrast=(1.0, 1.0)
    )
    scored = pool_of(held_out, as_they_are, config.augment.as_they_are())

    def finish() -> tuple[MesostructureScore, list[Sample]]:
        return score_patches(trainer.trained, scored), []

    return Task(pool.draw, config.steps, len(pool.patches), finish)
