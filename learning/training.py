"""What a family of networks brings to its training, and how its steps are fed.

That is a `Trainer`, its networks and optimisers, and a function that makes its `Task`: where
batches come from, and what comes after the steps. `learning.train` does the rest.
"""

from __future__ import annotations

import abc
import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from learning.checkpoint import INDEX, Checkpoint, load_tensors
from learning.clock import DATA, IDLE, Clock
from learning.config import TrainingConfig
from learning.devices import CPU, moved
from learning.loader import Ahead, threads_may_render
from learning.metrics_file import RATE
from learning.processes import ALONE, Processes
from learning.run import ScoreT
from learning.samples import Sample

BatchT = TypeVar("BatchT")
DrawnT = TypeVar("DrawnT", covariant=True)
ConfigT = TypeVar("ConfigT", bound=TrainingConfig)


class Trainer(abc.ABC, Generic[ConfigT, BatchT]):
    """A family's networks and their optimisers, one step at a time."""

    watched: ClassVar[str]
    """The loss that the guard watches."""
    renders: ClassVar[bool] = False
    """Whether a step uses the renderer, and not only what makes its batch."""
    role: ClassVar[str] = "network"
    """The checkpoint's role of the networks to infer with."""

    def __init__(
        self, config: ConfigT, device: torch.device = CPU, processes: Processes = ALONE
    ) -> None:
        """A subclass makes its networks after this, with random weights of the seed."""
        torch.manual_seed(config.seed)
        self.config, self.device, self.processes = config, device, processes
        self.clock = Clock()

    @abc.abstractmethod
    def set_rate(self, done: float, number: int) -> float:
        """Set the learning rate of step `number`, with the share `done` (0..1) past; returns it."""

    @abc.abstractmethod
    def step(self, batch: BatchT, number: int = 0) -> dict[str, float]:
        """Step `number` on this process's share of a batch, on the device; the losses."""

    @abc.abstractmethod
    def networks(self) -> Iterable[nn.Module]:
        """Those with which all processes must begin alike."""

    @abc.abstractmethod
    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""

    @abc.abstractmethod
    def take_over(self, saved: dict[str, dict[str, Tensor]], where: Path) -> None:
        """Take over what `tensors` gave; CheckpointError, with `where`, when it is another's."""

    @abc.abstractmethod
    def begin_with(self, weights: dict[str, Tensor], where: Path) -> None:
        """Take over a run's networks to infer with; CheckpointError as of `take_over`.

        Optimisers, and networks that only training needs, begin anew.
        """

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""
        saved = {role: load_tensors(checkpoint, role) for role in self.tensors()}
        self.take_over(saved, checkpoint.folder / INDEX)

    def batch_tensors(self, batch: BatchT) -> dict[str, Tensor]:
        """What of a batch is kept where the training goes astray."""
        names = [field.name for field in dataclasses.fields(batch)]  # type: ignore[arg-type]
        return {name: getattr(batch, name) for name in names}


class Draw(Protocol[DrawnT]):
    """Makes batches."""

    def __call__(self, count: int, rng: np.random.Generator, share: slice = ...) -> DrawnT:
        """A share of a batch of `count` random examples: what is drawn is the whole batch's."""


@dataclasses.dataclass(frozen=True)
class Task(Generic[BatchT, ScoreT]):
    """What a family's steps are fed with, and what comes after them.

    Attributes:
        draw: makes their batches.
        steps: of the training, where no time is given.
        examples: patches or scans trained on.
        finish: called once the steps are done; figures and samples of the people held out.
    """

    draw: Draw[BatchT]
    steps: int
    examples: int
    finish: Callable[[], tuple[ScoreT, list[Sample]]]


class BatchLearner(Generic[BatchT]):
    """A trainer, fed with random batches, made in a thread of their own once it is `ahead`."""

    def __init__(self, trainer: Trainer[Any, BatchT], draw: Draw[BatchT]) -> None:
        """The trainer's clock counts what its batches take, and what a step waits for them."""
        self._trainer, self._draw = trainer, draw
        self.watched = trainer.watched
        self._batches: Ahead[BatchT] | None = None

    @contextlib.contextmanager
    def ahead(self) -> Iterator[None]:
        """Within the block each step's batch is made while the networks take the one before."""
        with Ahead(self._own_share) as self._batches:
            yield
        self._batches = None

    def step(self, number: int, done: float) -> dict[str, float]:
        """See `Learner`."""
        trainer = self._trainer
        rate = trainer.set_rate(done, number)
        # Losses that are rendered on a processor use the compiled renderer too.
        together = trainer.device != CPU or not trainer.renders or threads_may_render()
        with trainer.clock.part(IDLE):
            if self._batches is not None and together:
                batch = self._batches.get(number)
            else:
                batch = self._own_share(number)
        return {RATE: rate, **trainer.step(moved(batch, trainer.device), number)}

    def batch(self, number: int) -> dict[str, Tensor]:
        """See `Learner`."""
        aside = None if self._batches is None else self._batches.aside
        drawn = self._drawn(number) if aside is None else aside(self._drawn, number)
        return self._trainer.batch_tensors(drawn)

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Learner`."""
        return self._trainer.tensors()

    def _own_share(self, number: int) -> BatchT:
        return self._drawn(number, self._trainer.processes.share(self._trainer.config.batch))

    def _drawn(self, number: int, share: slice = slice(None)) -> BatchT:
        config = self._trainer.config
        with self._trainer.clock.part(DATA):
            return self._draw(config.batch, np.random.default_rng([config.seed, 2, number]), share)
