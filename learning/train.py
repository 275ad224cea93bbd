"""Training: generator against discriminators, with the rendering loss."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from learning.checkpoint import (
    INDEX,
    Checkpoint,
    adam_tensors,
    fill,
    fill_adam,
    load_tensors,
    read_checkpoint,
    save_checkpoint,
)
from learning.data import Batch, PatchData
from learning.errors import CheckpointError, TrainingError
from learning.limits import require_within
from learning.losses import maps_loss, rendering_loss
from learning.networks.discriminator import Discriminators, feature_loss, verdict_loss
from learning.networks.generator import IN_CHANNELS, OUT_CHANNELS, Generator, initialise
from learning.presets import TrainConfig
from learning.score import Score, score
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.config import as_dict
from lightstage.formats.values import parse_json
from processing.dataset import Store


@dataclasses.dataclass(frozen=True)
class TrainResult:
    """What came of a training.

    Attributes:
        checkpoint: its index.
        steps: done in all, earlier calls included.
        seconds: of this call.
        patches: trained on.
        held_out: people who were not.
        score: of the people held out.
    """

    checkpoint: Path
    steps: int
    seconds: float
    patches: int
    held_out: list[str]
    score: Score


class Trainer:
    """Networks and optimisers, one step at a time."""

    def __init__(self, config: TrainConfig) -> None:
        """Networks with random weights of the configuration's seed."""
        torch.manual_seed(config.seed)
        self.config = config
        self.generator = Generator(config.generator)
        self.discriminators = Discriminators(IN_CHANNELS + OUT_CHANNELS, config.discriminator)
        initialise(self.generator)
        initialise(self.discriminators)
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

    def step(self, batch: Batch, rng: np.random.Generator) -> dict[str, float]:
        """One step of both; returns the losses."""
        config = self.config
        found = self.generator(batch.inputs) * batch.covered_channels
        real_pair = torch.cat([batch.inputs, batch.target], dim=1)
        judged_real = self.discriminators(real_pair)
        judged_fake = self.discriminators(torch.cat([batch.inputs, found.detach()], dim=1))
        # Halved, so that the discriminators learn at half the generator's pace [Wang2018].
        judging = 0.5 * (verdict_loss(judged_fake, False) + verdict_loss(judged_real, True))
        self._discriminator_adam.zero_grad(set_to_none=True)
        judging.backward()
        self._discriminator_adam.step()

        self.discriminators.requires_grad_(False)
        judged = self.discriminators(torch.cat([batch.inputs, found], dim=1))
        # By the discriminators as they are now, as the fake pair is judged: features of those of
        # before the step would differ even where the generator is right.
        with torch.no_grad():
            real_features = self.discriminators(real_pair)
        parts = {
            "adversarial": verdict_loss(judged, True),
            "features": config.feature_weight * feature_loss(real_features, judged),
            "maps": config.map_weight * maps_loss(found, batch),
        }
        if config.render_weight > 0:
            rendered = rendering_loss(found, batch, config.environments, config.lights, rng)
            parts["rendering"] = config.render_weight * rendered
        total = torch.stack(list(parts.values())).sum()
        self._generator_adam.zero_grad(set_to_none=True)
        total.backward()
        self._generator_adam.step()
        self.discriminators.requires_grad_(True)
        losses = {name: float(value.detach()) for name, value in parts.items()}
        return {**losses, "discriminators": float(judging.detach())}

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""
        return {
            "generator": dict(self.generator.state_dict()),
            "training": {
                **{f"discriminators.{k}": v for k, v in self.discriminators.state_dict().items()},
                **adam_tensors(self._generator_adam, "generator_adam"),
                **adam_tensors(self._discriminator_adam, "discriminator_adam"),
            },
        }

    def load(self, checkpoint: Checkpoint) -> None:
        """Take over a checkpoint's state."""
        where = checkpoint.folder / INDEX
        with torch.no_grad():
            saved = load_tensors(checkpoint, "training")
            fill(self.generator, load_tensors(checkpoint, "generator"), where)
            prefix = "discriminators."
            own = {k[len(prefix) :]: v for k, v in saved.items() if k.startswith(prefix)}
            fill(self.discriminators, own, where)
        fill_adam(self._generator_adam, saved, "generator_adam")
        fill_adam(self._discriminator_adam, saved, "discriminator_adam")


def train(
    store: Store,
    out: Path,
    config: TrainConfig,
    resume: bool = False,
    progress: ProgressCallback = quiet,
) -> TrainResult:
    """Train, score on the people held out, leave a checkpoint and metrics.jsonl in `out`.

    Every step draws its randomness from the seed and its own number, so a training that was
    interrupted and resumed goes on as if it had not been. Interrupting saves a checkpoint first.

    Args:
        store: the data.
        out: the run's folder.
        config: everything else.
        resume: go on from the checkpoint in `out`.
        progress: called with steps, or seconds where the time is given.

    Raises:
        TrainingError: too few people or patches, or losses that are not finite.
        CheckpointError: nothing to resume, another configuration or other data; or, without
            `resume`, a run that is there already.
    """
    began = time.monotonic()
    require_within(config, "training")
    held_out, trained_on = split(store, config.data.held_out_subjects)
    trainer, first = Trainer(config), 0
    if resume:
        checkpoint = read_checkpoint(out)
        _check_same(checkpoint, config, store)
        trainer.load(checkpoint)
        first = checkpoint.step
        _drop_half_line(out / "metrics.jsonl")
    elif (out / INDEX).exists():
        raise CheckpointError(
            out / INDEX,
            found="a run that is there already",
            expected="an empty folder",
            hint="Go on with --resume, or choose another --out.",
        )
    rng = np.random.default_rng([config.seed, 1])
    parts = (config.data, config.lights, config.augment)
    data = PatchData(store, trained_on, *parts, rng, config.shading)
    scored = PatchData(store, held_out, *parts, rng, config.shading)
    about: dict[str, Any] = {
        "config": as_dict(config),
        "data_fingerprint": store.fingerprint,
        "held_out": sorted(held_out),
        "texture_rows": store.scans[0].rows,
        "metrics": {},
    }
    total = max(1, math.ceil(config.epochs * len(data.places) / config.batch))
    finished, saved = first, time.monotonic()
    try:
        for step, done in _steps(first, total, config.seconds, progress):
            rng = np.random.default_rng([config.seed, 2, step])
            rate = trainer.set_rate(done)
            losses = trainer.step(data.draw(config.batch, rng), rng)
            finished = step + 1
            if not all(map(math.isfinite, losses.values())):
                raise TrainingError(
                    out,
                    field=f"step {step}",
                    found=f"losses {losses}",
                    expected="finite ones",
                    hint="Lower learning_rate; the last checkpoint is kept.",
                )
            if step % config.log_steps == 0:
                _log(out, {"step": step, "learning_rate": rate, **losses}, began)
            if time.monotonic() - saved > config.save_seconds:
                save_checkpoint(out, finished, trainer.tensors(), about)
                saved = time.monotonic()
    except KeyboardInterrupt:
        save_checkpoint(out, finished, trainer.tensors(), about)
        raise
    trainer.generator.eval()
    result = score(trainer.generator, scored, data, config.score_patches, config.seed)
    about["metrics"] = dataclasses.asdict(result)
    _log(out, {"step": finished, **about["metrics"]}, began)
    index = save_checkpoint(out, finished, trainer.tensors(), about)
    seconds = time.monotonic() - began
    return TrainResult(index, finished, seconds, len(data.places), sorted(held_out), result)


def split(store: Store, held_out: int) -> tuple[set[str], set[str]]:
    """People held out (the last by name) and people trained on.

    Raises:
        TrainingError: not at least one of each, or maps of several sizes.
    """
    sizes = sorted({scan.rows for scan in store.scans})
    if len(sizes) > 1:
        raise TrainingError(
            store.path,
            field="rows",
            found=", ".join(map(str, sizes)),
            expected="maps of one size",
            hint="Skin's detail has one size for the network; make all atlases equally large.",
        )
    people = sorted({scan.subject for scan in store.scans})
    if not 1 <= held_out < len(people):
        raise TrainingError(
            store.path,
            field="subjects",
            found=f"{len(people)}",
            expected=f"more than the {held_out} held out, and at least one of those",
            hint="Add people to the store; scans of one person all go to one side.",
        )
    return set(people[-held_out:]), set(people[:-held_out])


def _steps(
    first: int, total: int, seconds: float | None, progress: ProgressCallback
) -> Iterator[tuple[int, float]]:
    """Step numbers with the share that is done, until the steps or the time are used up."""
    began = time.monotonic()
    step = first
    while True:
        spent = time.monotonic() - began
        done = step / total if seconds is None else spent / seconds
        if done >= 1:
            return
        yield step, done
        step += 1
        if seconds is None:
            progress(step, total)
        else:
            progress(min(int(time.monotonic() - began), int(seconds)), max(1, int(seconds)))


def _check_same(checkpoint: Checkpoint, config: TrainConfig, store: Store) -> None:
    where = checkpoint.folder / INDEX
    wanted = parse_json(json.dumps(as_dict(config)), "configuration")
    # Before the shading could be chosen it was `physical`.
    begun = {"shading": "physical", **checkpoint.config}
    # How long to go on is a new decision each time.
    differing = {
        name: values for name, values in _differences(begun, wanted).items() if name != "seconds"
    }
    if differing:
        raise CheckpointError(
            where,
            field=", ".join(differing),
            found=", ".join(str(now) for _, now in differing.values()) + " now",
            expected=", ".join(str(then) for then, _ in differing.values()) + ", as the run began",
            hint="Resume with the same --preset, --config and --seed.",
        )
    if checkpoint.data_fingerprint != store.fingerprint:
        raise CheckpointError(
            where,
            field="data_fingerprint",
            found=checkpoint.data_fingerprint[:12],
            expected=f"{store.fingerprint[:12]}, of {store.path}",
            hint="The run was trained on other data.",
        )


def _differences(then: Any, now: Any, name: str = "") -> dict[str, tuple[Any, Any]]:
    """Values that two nested configurations do not share, by dotted name."""
    if not (isinstance(then, dict) and isinstance(now, dict)):
        return {} if then == now else {name: (then, now)}
    found: dict[str, tuple[Any, Any]] = {}
    for key in sorted(then.keys() | now.keys()):
        below = f"{name}.{key}" if name else key
        found |= _differences(then.get(key, "nothing"), now.get(key, "nothing"), below)
    return found


def _log(out: Path, values: dict[str, Any], began: float) -> None:
    out.mkdir(parents=True, exist_ok=True)
    line = {**values, "seconds": round(time.monotonic() - began, 2)}
    with (out / "metrics.jsonl").open("a") as handle:
        handle.write(json.dumps(line) + "\n")


def _drop_half_line(path: Path) -> None:
    """Cut off a last line that a killed training did not finish, so that none is joined to it."""
    if path.exists():
        whole = path.read_bytes().rfind(b"\n") + 1
        os.truncate(path, whole)
