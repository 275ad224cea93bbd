"""One run of an experiment: a training, its figures on the people held out, and its folder.

    RUN/run.json       what it is: setting, seed, budget, configuration, people, code
    RUN/training/      the training's own folder, until its figures are there
    RUN/metrics.jsonl  the training's curves
    RUN/figures.json   what came of it; a run that has it is finished
    RUN/LIGHT.png      of the first seed: texture, albedo found, true albedo

A run that was stopped is resumed from its training's last checkpoint.
"""

from __future__ import annotations

import dataclasses
import math
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learning.checkpoint import (
    INDEX,
    code_version,
    load_generator,
    load_whole_face,
    read_checkpoint,
)
from learning.config import TrainingConfig
from learning.devices import choose_device, device_name, memory_of
from learning.errors import TrainingError
from learning.experiments.config import ExperimentConfig
from learning.experiments.held_out import (
    FIGURES,
    Infer,
    Measured,
    measure,
    read_subjects,
    shadowed,
)
from learning.experiments.lights import NAMES, SIDE, TARGET
from learning.experiments.people import Halves, of_variant, store_of, subject_of, tones_of
from learning.experiments.variants import Variant, training_of
from learning.four.config import FourTrainConfig
from learning.four.infer import infer_four
from learning.four.networks import load_four_networks
from learning.infer import infer
from learning.metrics_file import METRICS
from learning.patch_config import PatchConfig
from learning.patch_light import target_environment
from learning.render.environments import Environment, RandomLightConfig
from learning.run import Run, TrainResult
from learning.train import TRAINERS, train
from learning.whole.infer import infer_whole_face
from lightstage.formats.config import as_dict
from lightstage.formats.files import read_json, without_nan, write_json
from lightstage.formats.png import write_png
from processing.colour import srgb_from_linear
from processing.dataset import Store, open_store

SCHEMA, FIGURES_SCHEMA = "lightstage.experiment.run/1", "lightstage.experiment.figures/1"
ABOUT, FIGURES_FILE, TRAINING = "run.json", "figures.json", "training"
TRAINED = "trained.json"
"""In the training's folder once it has ended: its figures, for a run that stops while measured."""
SHADOWS = "shadows"
"""Folder beside the runs: shadows that all of them share."""
LEAST_SECONDS = 1e-3
"""Seconds of a training whose time was used up before it was scored: one more step."""
DONE, DIVERGED, STOPPED = "done", "diverged", "stopped"
SHOWN = (TARGET, SIDE)
"""Lights of the pictures."""
SHOWN_PEOPLE = 5
"""How many people have pictures: the first ones held out, of the first seed."""
PICTURE_ROWS = 384
"""Rows of a picture, at most."""


@dataclasses.dataclass(frozen=True)
class Order:
    """What a worker is to do.

    Attributes:
        data: the store.
        runs: folder of all runs of this code.
        shadows: folder of the shadows that runs share.
        variant: the setting.
        budget: `steps` or `time`.
        seed: of the training.
        config: size of the experiment.
        halves: people.
        device: where the network runs, in words.
        keep_weights: keep the network beside its figures.
        deadline: seconds since the epoch after which the run stops, at its next step.
        stop: file whose presence stops the run likewise.
    """

    data: Path
    runs: Path
    shadows: Path
    variant: Variant
    budget: str
    seed: int
    config: ExperimentConfig
    halves: Halves
    device: str = "cpu"
    keep_weights: bool = False
    deadline: float = math.inf
    stop: Path | None = None

    @property
    def name(self) -> str:
        """Of the run, and of its folder."""
        return run_name(self.variant.name, self.budget, self.seed)

    @property
    def folder(self) -> Path:
        """Of the run."""
        return self.runs / self.name

    @property
    def source(self) -> Path:
        """Folder of the run whose network this one measures: its own, but for a refinement."""
        trained = self.variant.refines or self.variant.name
        return self.runs / run_name(trained, self.budget, self.seed)

    @property
    def finished(self) -> bool:
        """Whether its figures are there."""
        return (self.folder / FIGURES_FILE).is_file()

    def over(self) -> bool:
        """Whether the run is to stop."""
        return time.time() > self.deadline or (self.stop is not None and self.stop.exists())


def run_name(variant: str, budget: str, seed: int) -> str:
    """Of a run's folder."""
    return f"{variant}-{budget}-seed{seed}"


def one_run(order: Order) -> dict[str, Any]:
    """Do a run, or resume it; returns its figures, or that it was stopped.

    Raises:
        LightstageError: bad data, a device that is missing or full.
    """
    if order.finished:
        found: dict[str, Any] = read_json(order.folder / FIGURES_FILE, FIGURES_SCHEMA)
        return found
    if order.over():
        return {"state": STOPPED}
    try:
        return _run(order)
    except KeyboardInterrupt:
        if not order.over():
            raise
        return {"state": STOPPED}


def bake_shadows(order: Order) -> None:
    """Bake the shadows that a run needs, into the folder that all runs share; nothing is trained.

    A machine without Open3D, which casts them, can then do the run.
    """
    store, trained_on, held_out = _people(order)
    config = _config(order, held_out)
    shadowless = isinstance(config, PatchConfig) and not config.data.shadow_rows
    if not order.variant.refines and not shadowless:
        make, task_of = TRAINERS[config.family]
        run = Run(order.folder, config, {}, 0, time.monotonic(), shadows=order.shadows)
        task_of(make(config), store, trained_on, held_out, run)
    for subject in read_subjects(store, held_out, order.config.shadow_rows, order.shadows):
        shadowed(subject, _target(order), _lights(order))


def _run(order: Order) -> dict[str, Any]:
    began = time.monotonic()
    device = choose_device(order.device)
    store, trained_on, held_out = _people(order)
    config = _config(order, held_out)
    about = {
        "schema": SCHEMA,
        "variant": order.variant.name,
        "budget": order.budget,
        "seed": order.seed,
        "config": as_dict(config),
        "trained_on": sorted(map(subject_of, trained_on)),
        "held_out": sorted(map(subject_of, held_out)),
        "code": code_version(),
        "device": device_name(device),
        "texture_rows": store.scans[0].rows,
    }
    write_json(order.folder / ABOUT, about)
    figures = {**about, "schema": FIGURES_SCHEMA, "state": DONE}
    small = "Set a smaller batch or patch_px by --config, or fewer --jobs."
    full = "Use a GPU of more memory, fewer --jobs, or another --size."
    hint = full if order.config.published else small
    with memory_of(device, order.folder, hint):
        if order.variant.refines:
            figures |= _of_source(order)
        else:
            try:
                figures |= _trained(order, store, config, device)
            except TrainingError as error:
                if not error.field.startswith("step "):
                    raise
                figures |= {"state": DIVERGED, "said": str(error)}
        if figures["state"] == DONE:
            figures |= _measured(order, store, held_out, device)
    figures["seconds"] = time.monotonic() - began
    # Figures that are not finite are those of a run that diverged.
    write_json(order.folder / FIGURES_FILE, without_nan(figures))
    _tidy(order)
    return figures


def _of_source(order: Order) -> dict[str, Any]:
    """That the training which a run refines diverged, where it did.

    Raises:
        TrainingError: it is not finished.
    """
    path = order.source / FIGURES_FILE
    if not path.is_file():
        raise TrainingError(
            path,
            found="no such file",
            expected=f"the finished run that {order.name} refines",
            hint=f"Name {order.variant.refines} in --only too.",
        )
    source = read_json(path, FIGURES_SCHEMA)
    if source["state"] != DIVERGED:
        return {}
    return {"state": DIVERGED, "said": f"{order.variant.refines}: {source['said']}"}


def _people(order: Order) -> tuple[Store, set[str], set[str]]:
    """The store with the run's people alone, those trained on, those held out."""
    store = open_store(order.data)
    held_out = order.halves.held_out
    trained_on = of_variant(store, order.halves, order.variant, order.config, order.seed)
    own = store_of(store, trained_on, held_out)
    names = {scan.subject for scan in own.scans}
    apart = {name for name in names if subject_of(name) in held_out}
    return own, names - apart, apart


def _config(order: Order, held_out: set[str]) -> TrainingConfig:
    return training_of(order.variant, order.config, order.budget, order.seed, len(held_out))


def _target(order: Order) -> Environment:
    """The target of the run's seed, by the formulas that the people held out are shaded with."""
    return target_environment(RandomLightConfig(), "physical", order.seed)


def _lights(order: Order) -> tuple[str, ...]:
    chosen = NAMES[: order.config.environments]
    return chosen if SIDE in chosen or order.config.environments < 2 else (*chosen[:-1], SIDE)


def _trained(
    order: Order, store: Store, config: TrainingConfig, device: torch.device
) -> dict[str, Any]:
    """Train to the end; the figures of the training itself."""
    ticks: list[float] = []

    def progress(_: int, __: int) -> None:
        ticks.append(time.perf_counter())
        if order.over():
            raise KeyboardInterrupt

    folder = order.folder / TRAINING
    resume = _can_resume(folder)
    if resume and (folder / TRAINED).is_file():
        # It was stopped while it was measured.
        return dict(read_json(folder / TRAINED))
    if resume and config.seconds is not None:
        # A training counts its seconds anew in each call.
        left = config.seconds - read_checkpoint(folder).step_seconds
        config = dataclasses.replace(config, seconds=max(left, LEAST_SECONDS))
    result: TrainResult[Any] = train(
        store, folder, config, resume, progress, device, shadows=order.shadows
    )
    # The first step compiles loops, which is no part of a training's time.
    some = len(ticks) > 1
    each = (ticks[-1] - ticks[0]) / (len(ticks) - 1) if some else result.step_seconds
    figures = {
        "steps": result.steps,
        "step_seconds": each * result.steps,
        "steps_a_second": 1 / each if each > 0 else None,
        "shares": result.shares,
        "examples": result.examples,
        "score": dataclasses.asdict(result.score),
    }
    write_json(folder / TRAINED, without_nan(figures))
    return figures


def _can_resume(training: Path) -> bool:
    """Whether a training left a whole checkpoint; what is left of another is removed.

    A folder that was copied may lack the files that only a training needs.
    """
    if not (training / INDEX).exists():
        return False
    files = read_checkpoint(training).files.values()
    if all((training / file["name"]).is_file() for file in files):
        return True
    shutil.rmtree(training)
    return False


def _measured(
    order: Order, store: Store, held_out: set[str], device: torch.device
) -> dict[str, Any]:
    """Figures on the people held out, in all lights; pictures of the first seed's first ones."""
    infer_maps = _inference_of(order, order.source / TRAINING, device)
    originals = open_store(order.data)
    tones = tones_of(originals, tuple(map(subject_of, held_out)))
    people: list[dict[str, Any]] = []
    seconds: list[float] = []
    subjects = read_subjects(store, held_out, order.config.shadow_rows, order.shadows)
    for index, subject in enumerate(subjects):
        if order.over():
            raise KeyboardInterrupt
        found = measure(subject, _target(order), _lights(order), infer_maps)
        seconds += [one.seconds for one in found]
        each = {one.light: one.figures for one in found}
        people.append({"name": subject.name, "tone_deg": tones[subject.name], "lights": each})
        if index < SHOWN_PEOPLE and not order.seed:
            for one in found:
                if one.light in SHOWN:
                    path = order.folder / picture_name(index, one.light)
                    _write_picture(path, one, subject.maps["diffuse_albedo"])
    values = [f[name] for p in people for f in p["lights"].values() for name in FIGURES]
    wrong = not all(map(math.isfinite, values))
    diverged = {"state": DIVERGED, "said": "figures that are not finite"} if wrong else {}
    return {"people": people, "infer_seconds": float(np.median(seconds)), **diverged}


def _inference_of(order: Order, run: Path, device: torch.device) -> Infer:
    """What the run's network finds of a texture."""
    family = read_checkpoint(run).family
    pose = np.eye(3, 4)
    if family == "whole_face":
        whole, _ = load_whole_face(run)
        seconds = order.config.refine_seconds if order.variant.refines else 0.0
        return lambda texture, mesh: infer_whole_face(
            whole, texture, mesh, pose, refine_seconds=seconds, device=device
        )
    config = _config(order, set(order.halves.held_out))
    assert isinstance(config, PatchConfig)
    if family == FourTrainConfig.family:
        four = load_four_networks(run)[0].to(device)
        return lambda texture, mesh: infer_four(four, config.data, texture, mesh, pose)
    generator = load_generator(run)[0].to(device)
    return lambda texture, mesh: infer(generator, config.data, texture, mesh, pose)


def picture_name(person: int, light: str) -> str:
    """File, in a run's folder, of a person's picture; people count from 0."""
    return f"{light}-{person + 1}.png"


def _write_picture(path: Path, found: Measured, true: np.ndarray) -> None:
    """Texture, albedo found and true albedo, side by side, sRGB-encoded."""
    here = found.texture.any(axis=2, keepdims=True)
    parts = [found.texture, found.found["diffuse_albedo"] * here, true * here]
    step = slice(None, None, -(-len(true) // PICTURE_ROWS))
    encoded = [srgb_from_linear(np.clip(part[step, step], 0, 1)) for part in parts]
    write_png(path, np.round(255 * np.concatenate(encoded, axis=1)).astype(np.uint8))


def _tidy(order: Order) -> None:
    """Keep the training's curves, and its weights where the order keeps them."""
    training = order.folder / TRAINING
    if (training / METRICS).exists():
        shutil.copyfile(training / METRICS, order.folder / METRICS)
    if order.keep_weights:
        for path in training.glob("training-*.safetensors"):
            path.unlink()
        return
    shutil.rmtree(training, ignore_errors=True)
