"""Training of the `modern` preset: whole faces at low resolution, by squared errors alone."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from learning.augment import AugmentConfig
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
from learning.clock import IDLE, Clock
from learning.devices import CPU, device_of, moved
from learning.encoding import srgb_from_linear
from learning.forward import Forward
from learning.limits import require_within
from learning.loader import Ahead
from learning.losses import masked_mean
from learning.networks.whole_face import WholeFace, WholeFaceNetwork
from learning.processes import ALONE, Processes
from learning.run import TrainResult, begin, split
from learning.samples import MOST, Sample
from learning.whole.config import WholeTrainConfig
from learning.whole.detail import Shares, bands, enlarged
from learning.whole.faces import LEAST_ALBEDO, FaceBatch, Faces, FacesConfig
from learning.whole.score import FaceScore, score_faces
from lightstage.commands import ProgressCallback, quiet
from processing.dataset import Store

LEAST_DOUBT = 1e-3
"""Added to the variance of the network's error, so that it is never taken for certain."""
WARM_UP_STEPS = 50
"""Steps in which the rate rises, as Adam's means of gradients settle."""


class WholeFaceTrainer:
    """The network and its optimiser, one step at a time."""

    def __init__(
        self,
        config: WholeTrainConfig,
        device: torch.device = CPU,
        processes: Processes = ALONE,
    ) -> None:
        """Random weights of the configuration's seed, on a device."""
        torch.manual_seed(config.seed)
        self.config, self.processes = config, processes
        # Drawn on the processor, so that every device begins with the same weights. A step takes
        # 87 ms of one core with channels last and 105 without; the generator of patches gains
        # nothing, its discriminators a quarter.
        self.network = WholeFaceNetwork(config.network).to(device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = moving_average(self.network) if config.ema else None
        self._forward: Forward[WholeFace] = Forward(self.network, device, config)
        self._adam = torch.optim.AdamW(
            self.network.parameters(), config.learning_rate, weight_decay=config.weight_decay
        )

    def step(self, batch: FaceBatch, number: int, done: float) -> dict[str, float]:
        """One step of a training of which the share `done` is past; returns the losses."""
        rate = self.config.learning_rate * min(1.0, (number + 1) / WARM_UP_STEPS)
        rate *= 0.5 + 0.5 * math.cos(math.pi * min(1.0, done))
        for group in self._adam.param_groups:
            group["lr"] = rate
        losses = face_losses(self._forward, batch)
        if self.processes.count > 1:
            own = self.processes.weight(batch.weight.sum())
            losses = {name: own * value for name, value in losses.items()}
        weights = {
            "diffuse": 1.0,
            "specular": self.config.specular_weight,
            "deviation": self.config.deviation_weight,
        }
        total = torch.stack([weights[name] * value for name, value in losses.items()]).sum()
        self._adam.zero_grad(set_to_none=True)
        total.backward()
        self.processes.average_gradients(self.network.parameters())
        self._adam.step()
        if self.average is not None:
            follow(self.average, self.network, self.config.ema, number)
        return {"learning_rate": rate, **{name: float(v.detach()) for name, v in losses.items()}}

    @property
    def trained(self) -> WholeFaceNetwork:
        """The network to score and to infer with: the average where there is one."""
        return (self.network if self.average is None else self.average).eval()

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""
        state = {
            "network": dict(self.network.state_dict()),
            "training": adam_tensors(self._adam, "adam"),
        }
        if self.average is not None:
            state[AVERAGE] = dict(self.average.state_dict())
        return state

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""
        where = checkpoint.folder / INDEX
        fill(self.network, load_tensors(checkpoint, "network"), where)
        if self.average is not None:
            fill(self.average, load_tensors(checkpoint, AVERAGE), where)
        fill_adam(self._adam, load_tensors(checkpoint, "training"), "adam")


class FaceLearner:
    """The network, fed with random faces, made in a thread of their own once it is `ahead`."""

    watched: ClassVar[str] = "diffuse"

    def __init__(self, trainer: WholeFaceTrainer, faces: Faces, clock: Clock | None = None) -> None:
        """Train `trainer` on `faces`; what a step waits for its batch counts on `clock`."""
        self._trainer, self._faces, self._clock = trainer, faces, clock or Clock()
        self._batches: Ahead[FaceBatch] | None = None

    @contextlib.contextmanager
    def ahead(self) -> Iterator[None]:
        """Within the block each step's batch is made while the network takes the one before."""
        with Ahead(self._own_share) as self._batches:
            yield
        self._batches = None

    def step(self, number: int, done: float) -> dict[str, float]:
        """See `Learner`."""
        with self._clock.part(IDLE):
            made = self._own_share(number) if self._batches is None else self._batches.get(number)
        batch = moved(made, device_of(self._trainer.network))
        return self._trainer.step(batch, number, done)

    def batch(self, number: int) -> dict[str, Tensor]:
        """See `Learner`."""
        aside = None if self._batches is None else self._batches.aside
        drawn = self._drawn(number) if aside is None else aside(self._drawn, number)
        return {f.name: getattr(drawn, f.name) for f in dataclasses.fields(drawn)}

    def _own_share(self, number: int) -> FaceBatch:
        return self._drawn(number, self._trainer.processes.share(self._trainer.config.batch))

    def _drawn(self, number: int, share: slice = slice(None)) -> FaceBatch:
        config = self._trainer.config
        rng = np.random.default_rng([config.seed, 2, number])
        return self._faces.draw(config.batch, rng, share)

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Learner`."""
        return self._trainer.tensors()


def face_losses(network: Callable[[Tensor], WholeFace], batch: FaceBatch) -> dict[str, Tensor]:
    """Squared errors of what the network says, and how badly it knows its own error.

    Returns:
        diffuse: mean square of the sRGB-encoded diffuse albedo's error.
        specular: mean square of the error of the specular albedo's natural logarithm.
        deviation: of a normal distribution's negative log likelihood, with the expected error as
            its deviation; the error itself is given here, and is not made smaller by it.
    """
    said = network(batch.inputs)
    error = srgb_from_linear(said.diffuse_albedo) - srgb_from_linear(batch.diffuse_albedo)
    square = error.square()
    shine = said.specular_albedo.log() - batch.specular_albedo.clamp_min(1e-3).log()
    variance = said.deviation.square()
    given = square.detach().mean(dim=1, keepdim=True)
    return {
        "diffuse": masked_mean(square, batch.weight),
        "specular": masked_mean(shine.square(), batch.weight),
        "deviation": masked_mean(given / variance + variance.log(), batch.weight),
    }


def train_faces(
    store: Store,
    out: Path,
    config: WholeTrainConfig,
    resume: bool = False,
    progress: ProgressCallback = quiet,
    device: torch.device = CPU,
    processes: Processes = ALONE,
) -> TrainResult[FaceScore]:
    """Train on whole faces; arguments, errors and what is left in `out` as `learning.train.train`.

    At the end the shares of the texture's detail are fitted, on people trained on.
    """
    require_within(config, "training")
    held_out, trained_on = split(store, config.faces.held_out_subjects)
    processes.share(config.batch)
    trainer = WholeFaceTrainer(config, device, processes)
    run = begin(out, config, store, held_out, resume, trainer.load, processes)
    rng = np.random.default_rng([config.seed, 1])

    def faces_of(
        people: set[str], how: FacesConfig, skins: AugmentConfig, clock: Clock | None = None
    ) -> Faces:
        size, lights, mode = config.network, config.lights, config.shading
        return Faces(store, people, size, how, lights, skins, rng, mode, clock=clock)

    faces = faces_of(trained_on, config.faces, config.augment, run.clock)
    # Scored are people as they are, and all of their faces.
    whole = dataclasses.replace(config.faces, partial_share=0.0)
    own = dataclasses.replace(config.augment, melanin=0.0, haemoglobin=0.0)
    scored = faces_of(held_out, whole, own)
    network = trainer.network
    if not run.first:
        network.keep(faces.in_common(config.network.modes))
    processes.same_tensors(network.state_dict().values())
    learner = FaceLearner(trainer, faces, run.clock)
    with learner.ahead():
        steps = run.steps(learner, config.steps, progress)
    with run.scoring(learner, steps):
        trained = trainer.trained
        shares = torch.tensor(fit_shares(trained, faces, config))
        doubt = measured_doubt(trained, faces, config)
        for one in {network, trained}:
            one.detail_shares.copy_(shares)
            one.mode_doubt.copy_(doubt)
        result = score_faces(trained, scored, config.score_lights, config.seed)
        samples = _samples(trained, scored, config.seed)
    return run.end(learner, steps, len(faces.faces), result, samples)


def _samples(network: WholeFaceNetwork, held_out: Faces, seed: int) -> list[Sample]:
    """Each scan of the people held out under one light, and what the network makes of it."""
    rng = np.random.default_rng([seed, 5])
    found = []
    for index, name in enumerate(held_out.names[:MOST]):
        pair = held_out.batch([index], rng)
        with torch.inference_mode():
            said = moved(network(pair.inputs.to(device_of(network))), CPU)
        found.append(Sample(name, pair.texture, said.diffuse_albedo, pair.diffuse_albedo))
    return found


def fit_shares(network: WholeFaceNetwork, faces: Faces, config: WholeTrainConfig) -> list[float]:
    """How much of each band of a texture's detail is skin, over people trained on."""
    rng = np.random.default_rng([config.seed, 4])
    shares = Shares()
    for _ in range(config.detail_pairs):
        pair = faces.draw_large(rng)
        with torch.inference_mode():
            said = moved(network(pair.inputs.to(device_of(network))), CPU)
        low = said.diffuse_albedo[0].permute(1, 2, 0).log().numpy()
        rows, columns = pair.texture.shape[:2]
        small = pair.small[0].permute(1, 2, 0).numpy()
        wanted = np.log(np.maximum(pair.diffuse_albedo, 1e-3)) - enlarged(low, rows, columns)
        shares.add(bands(pair.texture, pair.covered, small), wanted, pair.skin)
    return shares.solve()


def measured_doubt(network: WholeFaceNetwork, faces: Faces, config: WholeTrainConfig) -> Tensor:
    """(modes, modes) mean square of the network's error along the modes, in people's deviations.

    Over people trained on, in lights that they were not trained in. It is what refinement takes
    the network's answer for.
    """
    rng = np.random.default_rng([config.seed, 6])
    mean = network.mean_log_albedo.cpu()
    errors = []
    for _ in range(max(1, config.doubt_faces // config.batch)):
        pair = faces.draw(config.batch, rng)
        with torch.inference_mode():
            said = moved(network(pair.inputs.to(device_of(network))), CPU).diffuse_albedo.log()
        true = pair.diffuse_albedo.clamp_min(LEAST_ALBEDO).log()
        known = (said - mean, true - mean, pair.weight)
        for said_one, true_one, weight in zip(*known, strict=True):
            found = network.along_modes(torch.stack([said_one, true_one]), weight)
            errors.append(found[0] - found[1])
    each = torch.stack(errors)
    # A direction that so few people have is known no better than people differ in it.
    return each.T @ each / len(each) + LEAST_DOUBT * torch.eye(len(each[0]))
