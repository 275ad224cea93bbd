"""Training of any family of networks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from learning.checkpoint import INDEX, Checkpoint, read_checkpoint, trained_tensors
from learning.config import TrainingConfig
from learning.devices import CPU
from learning.errors import CheckpointError
from learning.four.config import FourTrainConfig
from learning.four.train import FourTrainer
from learning.limits import require_within
from learning.mesostructure.config import MesostructureTrainConfig
from learning.mesostructure.train import MesostructureTrainer, mesostructure_task
from learning.patch_config import TrainConfig
from learning.patch_run import patch_task
from learning.patch_train import PatchTrainer
from learning.processes import ALONE, Processes
from learning.run import TrainResult, begin, split
from learning.training import BatchLearner, Task, Trainer
from learning.upscale.config import UpscaleTrainConfig
from learning.upscale.train import UpscaleTrainer, upscale_task
from learning.whole.config import WholeTrainConfig
from learning.whole.train import WholeFaceTrainer, face_task
from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from processing.dataset import Store

TRAINERS: dict[str, tuple[type[Trainer[Any, Any]], Callable[..., Task[Any, Any]]]] = {
    TrainConfig.family: (PatchTrainer, patch_task),
    FourTrainConfig.family: (FourTrainer, patch_task),
    WholeTrainConfig.family: (WholeFaceTrainer, face_task),
    UpscaleTrainConfig.family: (UpscaleTrainer, upscale_task),
    MesostructureTrainConfig.family: (MesostructureTrainer, mesostructure_task),
}
"""For each family its trainer, and the function that makes its task from that trainer, the store,
people trained on, people held out, and the run that has begun."""


def weights_of(
    path: Path, trainer: Trainer[Any, Any], store: Store, held_out: set[str]
) -> Checkpoint:
    """Another run, whose networks a trainer begins with.

    Args:
        path: of the run.
        trainer: takes its networks.
        store: the new run's data.
        held_out: people who are to be scored, and not trained on.

    Raises:
        CheckpointError: networks of another family or size, or trained on people of this store who
            are held out now.
    """
    other = read_checkpoint(path)
    family, where = trainer.config.family, other.folder / INDEX
    if other.family != family:
        raise CheckpointError(
            where,
            field="family",
            found=other.family,
            expected=f"{family}, the given preset's",
            hint="Begin with a run of the same family, or choose its --preset.",
        )
    known = sorted(held_out - set(other.held_out))
    if other.data_fingerprint != store.fingerprint:
        # Of another store some people may be the same.
        own = [scan for scan in store.scans if scan.subject in held_out]
        # Checkpoints of an earlier version have the scans' own hashes.
        scans = {key: scan.subject for scan in own for key in (scan.trace, scan.sha256)}
        known = sorted({scans[key] for key in other.trained_on if key in scans})
    if known:
        raise CheckpointError(
            where,
            field="held_out",
            found=f"{counted(len(known), 'person', 'people')} that it was trained on ({known[0]})",
            expected="all people who are held out now",
            hint="Hold out no more people of this store than that run did.",
        )
    trainer.begin_with(trained_tensors(other, trainer.role), where)
    return other


def other_rows(begun: Path | None, config: TrainingConfig, store: Store) -> str:
    """A warning where weights that are begun with know detail of another size; empty elsewhere.

    Args:
        begun: run whose weights they are, or None.
        config: of the new run.
        store: the new run's data.
    """
    if begun is None or config.family == WholeTrainConfig.family:
        return ""  # whole faces have the network's own rows
    known, shown = read_checkpoint(begun).texture_rows, config.rows_shown(store.scans[0].rows)
    if known == shown:
        return ""
    return (
        f"the weights of {begun} were trained on maps of {known} rows and these have {shown}, in "
        "which skin's detail has another size: compare the figures with a run of random weights"
    )


def train(
    store: Store,
    out: Path,
    config: TrainingConfig,
    resume: bool = False,
    progress: ProgressCallback = quiet,
    device: torch.device = CPU,
    processes: Processes = ALONE,
    shadows: Path | None = None,
    begin_with: Path | None = None,
) -> TrainResult[Any]:
    """Train, score on the people held out, leave a checkpoint and metrics.jsonl in `out`.

    Every step draws its randomness from the seed and its own number, so a training that was
    interrupted and resumed continues as if it had not been. Interrupting saves a checkpoint first.

    Args:
        store: the data.
        out: the run's folder.
        config: everything else; its class decides the family.
        resume: continue from the checkpoint in `out`.
        progress: called with steps, or seconds where the time is given.
        device: where the networks run; what they are fed with is made on the processor.
        processes: that train together, of which this is one. The batch is that of all of them.
        shadows: folder of baked shadows that trainings share; None where each bakes its own.
        begin_with: a run, whose networks this one begins with; random weights where None.

    Returns:
        With the family's own figures.

    Raises:
        TrainingError: too few people or patches, or losses that are not finite.
        CheckpointError: nothing to resume, another configuration or other data; or, without
            `resume`, a run that is there already; or another training that writes there; or
            networks to begin with that do not suit (`weights_of`).
    """
    make, task_of = TRAINERS[config.family]
    require_within(config, "training")
    held_out, trained_on = split(store, config.held_out_subjects)
    processes.share(config.batch)
    trainer = make(config, device, processes)
    other = None if begin_with is None else weights_of(begin_with, trainer, store, held_out)
    run = begin(out, config, store, held_out, resume, trainer.load, processes, shadows, other)
    trainer.clock = run.clock
    task = task_of(trainer, store, trained_on, held_out, run)
    for network in trainer.networks():
        processes.same_tensors(network.state_dict().values())
    learner = BatchLearner(trainer, task.draw)
    with run.alone():
        with learner.ahead():
            steps = run.steps(learner, task.steps, progress)
        with run.scoring(learner, steps):
            score, samples = task.finish()
        return run.end(learner, steps, task.examples, score, samples)
