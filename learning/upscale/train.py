"""Training of RCAN on textures: absolute differences of sRGB-encoded colours, nothing else."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from learning.augment import AugmentConfig
from learning.checkpoint import INDEX, Checkpoint, adam_tensors, fill, fill_adam, load_tensors
from learning.clock import IDLE, Clock
from learning.devices import CPU, device_of, moved
from learning.limits import require_within
from learning.processes import ALONE, Processes
from learning.run import TrainResult, begin, split
from learning.upscale.config import UpscaleTrainConfig
from learning.upscale.data import PatchPairs, Pictures
from learning.upscale.network import Rcan
from learning.upscale.score import UpscaleScore, score_upscaling
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store


class UpscaleLearner:
    """RCAN and its optimiser, fed with random patches."""

    watched: ClassVar[str] = "difference"

    def __init__(
        self,
        config: UpscaleTrainConfig,
        device: torch.device = CPU,
        processes: Processes = ALONE,
    ) -> None:
        """Random weights of the configuration's seed; `feed` comes before the first step."""
        torch.manual_seed(config.seed)
        self.config, self.processes = config, processes
        # A fifth faster on a processor than planes of channels.
        self.network = Rcan(config.network).to(device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._adam = torch.optim.Adam(self.network.parameters(), config.learning_rate)
        self._pictures: Pictures | None = None
        self.clock = Clock()

    def feed(self, pictures: Pictures, clock: Clock) -> None:
        """Train on these from now on; the time to draw patches counts on `clock`."""
        self._pictures, self.clock = pictures, clock

    def step(self, number: int, done: float) -> dict[str, float]:
        """See `Learner`."""
        rate = self.config.learning_rate * 0.5 ** int(min(done, 1.0) * self.config.rates)
        for group in self._adam.param_groups:
            group["lr"] = rate
        with self.clock.part(IDLE):
            drawn, own = self._drawn(number), self.processes.share(self.config.batch)
        pairs = moved(PatchPairs(drawn.inputs[own], drawn.target[own]), device_of(self.network))
        loss = functional.l1_loss(self.network(pairs.inputs), pairs.target)
        self._adam.zero_grad(set_to_none=True)
        loss.backward()
        self.processes.average_gradients(self.network.parameters())
        self._adam.step()
        return {"learning_rate": rate, "difference": float(loss.detach())}

    def batch(self, number: int) -> dict[str, Tensor]:
        """See `Learner`."""
        pairs = self._drawn(number)
        return {"inputs": pairs.inputs, "target": pairs.target}

    def _drawn(self, number: int) -> PatchPairs:
        assert self._pictures is not None
        rng = np.random.default_rng([self.config.seed, 2, number])
        return self._pictures.draw(self.config.batch, rng)

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Learner`."""
        return {
            "network": dict(self.network.state_dict()),
            "training": adam_tensors(self._adam, "adam"),
        }

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""
        fill(self.network, load_tensors(checkpoint, "network"), checkpoint.folder / INDEX)
        fill_adam(self._adam, load_tensors(checkpoint, "training"), "adam")


def train_upscaling(
    store: Store,
    out: Path,
    config: UpscaleTrainConfig,
    resume: bool = False,
    progress: ProgressCallback = quiet,
    device: torch.device = CPU,
    processes: Processes = ALONE,
) -> TrainResult[UpscaleScore]:
    """Train RCAN; arguments, errors and what is left in `out` as `learning.train.train`."""
    require_within(config, "training")
    held_out, trained_on = split(store, config.pictures.held_out_subjects)
    processes.share(config.batch)
    learner = UpscaleLearner(config, device, processes)
    run = begin(out, config, store, held_out, resume, learner.load, processes)
    rng = np.random.default_rng([config.seed, 1])

    def pictures_of(people: set[str], count: int, skins: AugmentConfig) -> Pictures:
        return Pictures(
            store,
            people,
            config.network.times,
            count,
            config.pictures,
            config.lights,
            skins,
            rng,
            config.shading,
        )

    pictures = pictures_of(trained_on, config.pictures.count, config.augment)
    # Scored are people as they are.
    own = dataclasses.replace(config.augment, melanin=0.0, haemoglobin=0.0)
    scans = sum(scan.subject in held_out for scan in store.scans)
    scored = pictures_of(held_out, 2 * config.score_lights * scans, own)
    learner.feed(pictures, run.clock)
    if not run.first:
        learner.network.mean_srgb.copy_(pictures.mean_srgb())
    processes.same_tensors(learner.network.state_dict().values())
    steps = run.steps(learner, config.steps, progress)
    with run.scoring(learner, steps):
        learner.network.eval()
        result = score_upscaling(learner.network, scored.pictures)
    return run.end(learner, steps, len(pictures.pictures), result)
