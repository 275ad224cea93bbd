"""Training of RCAN on textures: absolute differences of sRGB-encoded colours, nothing else."""

from __future__ import annotations

import numpy as np
import torch.nn.functional as functional
from torch import Tensor

from learning.augment import AugmentConfig
from learning.network_trainer import NetworkTrainer
from learning.run import Run
from learning.samples import Sample
from learning.training import Task
from learning.upscale.config import UpscaleTrainConfig
from learning.upscale.data import PatchPairs, Pictures
from learning.upscale.network import Rcan
from learning.upscale.score import UpscaleScore, score_upscaling
from processing.dataset import Store


class UpscaleTrainer(NetworkTrainer[UpscaleTrainConfig, PatchPairs, Rcan]):
    """RCAN and its optimiser."""

    watched = "difference"

    def fresh(self) -> Rcan:
        """See `NetworkTrainer`."""
        return Rcan(self.config.network)

    def rate(self, done: float, _: int) -> float:
        """It halves from part to part."""
        return self.config.learning_rate * 0.5 ** int(min(done, 1.0) * self.config.rates)

    def losses(self, batch: PatchPairs) -> dict[str, Tensor]:
        """See `NetworkTrainer`."""
        return {"difference": functional.l1_loss(self.forward(batch.inputs), batch.target)}


def upscale_task(
    trainer: UpscaleTrainer, store: Store, trained_on: set[str], held_out: set[str], run: Run
) -> Task[PatchPairs, UpscaleScore]:
    """Random patches; the people held out are scored at the end (see `learning.train.TRAINERS`)."""
    config = trainer.config
    rng = np.random.default_rng([config.seed, 1])

    def pictures_of(people: set[str], count: int, skins: AugmentConfig) -> Pictures:
        times, how = config.network.times, config.pictures
        lights, mode = config.lights, config.shading
        return Pictures(store, people, times, count, how, lights, skins, rng, mode)

    pictures = pictures_of(trained_on, config.pictures.count, config.augment)
    scans = sum(scan.subject in held_out for scan in store.scans)
    scored = pictures_of(held_out, 2 * config.score_lights * scans, config.augment.as_they_are())
    if run.anew:
        trainer.network.mean_srgb.copy_(pictures.mean_srgb())

    def finish() -> tuple[UpscaleScore, list[Sample]]:
        return score_upscaling(trainer.trained, scored.pictures), []

    return Task(pictures.draw, config.steps, len(pictures.pictures), finish)
