"""What trainings on patches share, of one network and of four: their data, figures and samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from learning.augment import AugmentConfig
from learning.data import Batch, PatchData
from learning.encoding import Reflectance
from learning.four.train import FourTrainer
from learning.patch_train import PatchTrainer
from learning.run import Run
from learning.samples import MOST, Sample
from learning.score import Score, score
from learning.training import Task
from processing.dataset import Store


def patch_task(
    trainer: PatchTrainer | FourTrainer,
    store: Store,
    trained_on: set[str],
    held_out: set[str],
    run: Run,
) -> Task[Batch, Score]:
    """Random patches; the people held out are scored at the end (see `learning.train.TRAINERS`)."""
    config = trainer.config
    rng, seed = np.random.default_rng([config.seed, 1]), config.seed

    def patches(people: set[str], augment: AugmentConfig, **more: Any) -> PatchData:
        how = (config.data, config.lights, augment, rng, config.shading)
        return PatchData(store, people, *how, seed=seed, shadows=run.shadows, **more)

    data = patches(trained_on, config.augment, clock=run.clock, draws=config.draws)
    scored = patches(held_out, config.augment.as_they_are())

    def finish() -> tuple[Score, list[Sample]]:
        answers = trainer.answers()
        found = score(answers, scored, data, config.score_patches, seed)
        return found, _samples(answers, scored, store, seed)

    steps = config.steps or max(1, math.ceil(config.epochs * len(data.places) / config.batch))
    return Task(data.draw, steps, len(data.places), finish)


def _samples(
    answers: Callable[[Batch], Reflectance], held_out: PatchData, store: Store, seed: int
) -> list[Sample]:
    """Patches from over the people held out, and what the networks make of them."""
    rng = np.random.default_rng([seed, 6])
    count = min(MOST, len(held_out.places))
    found = []
    for index in np.linspace(0, len(held_out.places) - 1, count).round().astype(int):
        batch = held_out.batch([held_out.places[index]], rng)
        with torch.inference_mode():
            albedo = answers(batch).diffuse_albedo
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
