"""A training on patches from first step to last: what one network and four share."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from learning.checkpoint import Checkpoint
from learning.clock import IDLE, Clock
from learning.data import Batch, PatchData
from learning.devices import CPU, moved
from learning.encoding import Reflectance
from learning.four.config import FourTrainConfig
from learning.limits import require_within
from learning.loader import Ahead, threads_may_render
from learning.presets import TrainConfig
from learning.processes import Processes
from learning.run import TrainResult, begin, split
from learning.samples import MOST, Sample
from learning.score import Score, score
from lightstage.commands import ProgressCallback
from processing.dataset import Store


class PatchTrainer(Protocol):
    """Networks of patches and their optimisers, one step at a time."""

    clock: Clock
    """What a step renders and waits for counts on it."""

    @property
    def config(self) -> TrainConfig | FourTrainConfig:
        """Of the training."""

    @property
    def device(self) -> torch.device:
        """Where the networks are."""

    @property
    def processes(self) -> Processes:
        """That train together."""

    def set_rate(self, done: float) -> float:
        """Set the learning rate for a training that is `done` (0..1); returns it."""

    def step(self, batch: Batch, number: int = 0) -> dict[str, float]:
        """Step `number` on this process's share of a batch, on the device; the losses."""

    def kept(self, batch: Batch) -> dict[str, Tensor]:
        """What of a batch is kept where the training goes astray."""

    def networks(self) -> Iterable[nn.Module]:
        """Those with which all processes must begin alike."""

    def answers(self) -> Callable[[Batch], Reflectance]:
        """What the networks to infer with find on patches of the processor."""

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""


class PatchLearner:
    """The networks, fed with random patches, made in a thread of their own once it is `ahead`."""

    watched: ClassVar[str] = "error"

    def __init__(self, trainer: PatchTrainer, data: PatchData) -> None:
        """Train `trainer` on `data`; its clock counts what a step waits for its batch."""
        self._trainer, self._data = trainer, data
        self._batches: Ahead[Batch] | None = None

    @contextlib.contextmanager
    def ahead(self) -> Iterator[None]:
        """Within the block each step's batch is made while the networks take the one before."""
        with Ahead(self._own_share) as self._batches:
            yield
        self._batches = None

    def step(self, number: int, done: float) -> dict[str, float]:
        """See `Learner`."""
        rate, device = self._trainer.set_rate(done), self._trainer.device
        # On a processor the rendering loss uses the compiled renderer too.
        together = device != CPU or threads_may_render()
        with self._trainer.clock.part(IDLE):
            if self._batches is not None and together:
                batch = self._batches.get(number)
            else:
                batch = self._own_share(number)
        return {"learning_rate": rate, **self._trainer.step(moved(batch, device), number)}

    def batch(self, number: int) -> dict[str, Tensor]:
        """See `Learner`."""
        aside = None if self._batches is None else self._batches.aside
        drawn = self._drawn(number) if aside is None else aside(self._drawn, number)
        return self._trainer.kept(drawn)

    def _own_share(self, number: int) -> Batch:
        return self._drawn(number, self._trainer.processes.share(self._trainer.config.batch))

    def _drawn(self, number: int, share: slice = slice(None)) -> Batch:
        config = self._trainer.config
        return self._data.draw(config.batch, np.random.default_rng([config.seed, 2, number]), share)

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Learner`."""
        return self._trainer.tensors()


def train_patches(
    store: Store,
    out: Path,
    config: TrainConfig | FourTrainConfig,
    make: Callable[[], PatchTrainer],
    draws: int,
    resume: bool,
    progress: ProgressCallback,
    processes: Processes,
) -> TrainResult[Score]:
    """Train what `make` makes; otherwise as `learning.train.train`.

    Args:
        store: the data.
        out: the run's folder.
        config: of the training.
        make: the trainer, once the configuration was looked through.
        draws: environments of each pair beside the input's own.
        resume: go on from the checkpoint in `out`.
        progress: called with steps, or seconds where the time is given.
        processes: that train together, of which this is one.
    """
    require_within(config, "training")
    held_out, trained_on = split(store, config.data.held_out_subjects)
    processes.share(config.batch)
    trainer = make()
    run = begin(out, config, store, held_out, resume, trainer.load, processes)
    for network in trainer.networks():
        processes.same_tensors(network.state_dict().values())
    rng = np.random.default_rng([config.seed, 1])
    parts = (config.data, config.lights, config.augment)
    shading, seed = config.shading, config.seed
    trainer.clock = run.clock
    data = PatchData(
        store, trained_on, *parts, rng, shading, clock=run.clock, draws=draws, seed=seed
    )
    scored = PatchData(store, held_out, *parts, rng, shading, seed=seed)
    learner = PatchLearner(trainer, data)
    total = max(1, math.ceil(config.epochs * len(data.places) / config.batch))
    with learner.ahead():
        steps = run.steps(learner, total, progress)
    with run.scoring(learner, steps):
        said = trainer.answers()
        result = score(said, scored, data, config.score_patches, seed)
        samples = _samples(said, scored, store, seed)
    return run.end(learner, steps, len(data.places), result, samples)


def _samples(
    said: Callable[[Batch], Reflectance], held_out: PatchData, store: Store, seed: int
) -> list[Sample]:
    """Patches from over the people held out, and what the networks make of them."""
    rng = np.random.default_rng([seed, 6])
    count = min(MOST, len(held_out.places))
    found = []
    for index in np.linspace(0, len(held_out.places) - 1, count).round().astype(int):
        batch = held_out.batch([held_out.places[index]], rng)
        with torch.inference_mode():
            albedo = said(batch).diffuse_albedo
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
