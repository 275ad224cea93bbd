"""One training from its first step to its last: steps or seconds, saves, metrics, resuming.

What is trained is a `Learner`; this is what all of them share.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from torch import Tensor

from learning.checkpoint import (
    INDEX,
    Checkpoint,
    not_finite,
    read_checkpoint,
    save_checkpoint,
    save_tensors,
)
from learning.clock import NETWORK, Clock
from learning.errors import CheckpointError, TrainingError
from learning.event_file import EVENTS, EventFile
from learning.guard import LEAP, LEAP_FROM_FIRST, WINDOW, Guard
from learning.metrics_file import METRICS, drop_lost_lines, scores_at
from learning.processes import ALONE, Processes
from learning.resuming import require_same_run
from learning.same_scans import require_other_scans
from learning.samples import Sample, write_samples
from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.errors import DiskError
from lightstage.formats.config import as_dict
from lightstage.formats.files import others_in
from lightstage.formats.lock import locked
from lightstage.interrupts import first_signal_noted
from processing.dataset import Store

LOCK = "training.lock"
"""Held while a training writes into its folder; the empty file stays."""
OWN = (METRICS, LOCK, "*.safetensors", "events.*", "samples.html", ".*")
"""What a run that stopped before its first checkpoint leaves, half-written files too."""


class Learner(Protocol):
    """A network in training."""

    watched: str
    """The loss that the guard watches."""

    def step(self, number: int, done: float) -> dict[str, float]:
        """Take step `number` of a training of which the share `done` (0..1) is past; the losses.

        All randomness follows from the seed and `number`, so that a training that was interrupted
        continues as if it had not been.
        """

    def batch(self, number: int) -> dict[str, Tensor]:
        """What step `number` was fed with."""

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """All state, by the checkpoint's roles."""


class Scored(Protocol):
    """Figures of the people held out: a dataclass of floats."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    scored: ClassVar[str]
    """What the figures are of."""

    def sentence(self) -> str:
        """The figures that matter, for the command's last line."""

    def guesses(self) -> dict[str, float]:
        """PSNR in dB of plain guesses, by name, which a network should be better than."""

    @property
    def psnr_db(self) -> float:
        """The network's."""


ScoreT = TypeVar("ScoreT", bound=Scored)


@dataclasses.dataclass(frozen=True)
class TrainResult(Generic[ScoreT]):
    """What came of a training.

    Attributes:
        checkpoint: its index.
        steps: done in all, earlier calls included.
        first: of these, the ones that earlier calls did.
        seconds: of this call.
        step_seconds: of this call's steps.
        examples: patches or scans trained on.
        held_out: people who were not.
        score: of the people held out.
        shares: of the steps' time: `data`, `rendering`, `network`, `idle` (see learning.clock).
    """

    checkpoint: Path
    steps: int
    first: int
    seconds: float
    step_seconds: float
    examples: int
    held_out: list[str]
    score: ScoreT
    shares: dict[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Run:
    """A folder with one training in it.

    Attributes:
        out: the folder.
        config: of the training; its `seconds`, `log_steps` and `save_seconds` hold here.
        about: the checkpoint's other fields.
        first: step to begin with.
        began: monotonic seconds.
        spent: seconds of the steps of earlier calls, but for the first of each.
        processes: that train together; the first alone writes.
        events: of this call, as TensorBoard reads them.
        clock: of this call's steps. What makes batches and renders counts its own parts on it; what
            is left of a step counts as the network's.
        shadows: folder of baked shadows that trainings share; None where each bakes its own.
        anew: whether its networks began with random weights, and not with another run's.
    """

    out: Path
    config: Any
    about: dict[str, Any]
    first: int
    began: float
    spent: float = 0.0
    processes: Processes = ALONE
    events: EventFile | None = None
    clock: Clock = dataclasses.field(default_factory=Clock)
    shadows: Path | None = None
    anew: bool = True

    def steps(self, learner: Learner, total: int, progress: ProgressCallback = quiet) -> int:
        """Train until the steps or the seconds are used up; returns the steps done in all.

        A checkpoint is saved every `save_seconds`, and when the training is interrupted: once the
        step is whole, in all processes after the same one. Where the losses go astray, the step's
        batch is kept in `stopped-STEP.safetensors`.

        Raises:
            TrainingError: losses or weights that are not finite, or losses that leapt and stay
                high.
        """
        finished, saved, whole = self.first, time.monotonic(), True
        guard = Guard()
        with first_signal_noted() as signals:
            try:
                for step, done in self._steps(total, progress):
                    whole = False
                    with self.clock.part(NETWORK):
                        losses = self._mean(learner.step(step, done))
                    finished, whole = step + 1, True
                    if step == self.first:
                        # It compiles loops, for a minute on a busy machine.
                        self.clock.first_seconds = self.clock.step_seconds
                    if not all(map(math.isfinite, losses.values())):
                        raise self._astray(learner, step, f"losses {losses}", "finite ones")
                    if guard.leapt(losses[learner.watched]):
                        found = (
                            f"{learner.watched} {LEAP:g} times its lowest mean of {WINDOW} steps, "
                            f"or {LEAP_FROM_FIRST:g} times its first"
                        )
                        raise self._astray(learner, step, found, "a loss that falls")
                    if step % self.config.log_steps == 0:
                        self.log({"step": step, **losses})
                    if time.monotonic() - saved > self.config.save_seconds:
                        self._save(learner, finished, self.about)
                        saved = time.monotonic()
                    if any(self.processes.mean([float(signals.came)])):
                        raise KeyboardInterrupt
            except KeyboardInterrupt:
                # Of a step that was cut short, weights may be new and the optimiser's state old.
                if whole:
                    self._save(learner, finished, self.about)
                raise
        return finished

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other trainings out of the folder within the block.

        What is left there of steps that no checkpoint has is removed first. On a disk that cannot
        lock files nothing keeps other trainings out.

        Raises:
            CheckpointError: another training writes there, or did since this one began.
        """
        with contextlib.ExitStack() as held:
            if self.processes.first:
                busy = CheckpointError(
                    self.out,
                    found="another training that writes there now",
                    expected="a folder of this one's own",
                    hint="Wait until it ends, or choose another --out.",
                )
                with contextlib.suppress(DiskError):
                    held.enter_context(locked(self.out / LOCK, busy))
                there = read_checkpoint(self.out).step if (self.out / INDEX).exists() else 0
                if there != self.first:
                    raise CheckpointError(
                        self.out / INDEX,
                        found=f"step {there}, of another training that ended meanwhile",
                        expected=f"step {self.first}, as when this one began",
                        hint="Resume it with --resume, or choose another --out.",
                    )
                self._drop_lost()
            yield

    def _drop_lost(self) -> None:
        """Remove the curves of steps that no checkpoint has."""
        if (self.out / INDEX).exists():
            metrics = self.out / METRICS
            if drop_lost_lines(metrics, self.first) and self.events is not None:
                self.events.begin_again(self.first, scores_at(metrics, self.first))
            return
        # Of a run that ended before its first checkpoint: its curves are not this one's.
        for path in (self.out / METRICS, *self.out.glob(f"{EVENTS}*")):
            path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def scoring(self, learner: Learner, steps: int) -> Iterator[None]:
        """Within the block an interrupt saves the steps that are done, as it does among them."""
        try:
            yield
        except KeyboardInterrupt:
            if steps > self.first:
                self._save(learner, steps, self.about)
            raise

    def _steps(self, total: int, progress: ProgressCallback) -> Iterator[tuple[int, float]]:
        """Step numbers with the share that is done, until the steps or the time are used up.

        The time is the first process's. That of earlier calls counts in the share, so that a
        learning rate which falls with it does not begin at its largest again.
        """
        began, step, seconds = time.monotonic(), self.first, self.config.seconds
        shown = progress if self.processes.first else quiet
        before = self.spent
        while True:
            if seconds is None:
                done = step / total
            else:
                done = (before + time.monotonic() - began) / (before + seconds)
            done = self.processes.of_first(done)
            if done >= 1:
                return
            yield step, done
            if step == self.first:
                began = time.monotonic()  # what that compiled is no part of the time
            step += 1
            if seconds is None:
                shown(step, total)
            else:
                shown(min(int(time.monotonic() - began), int(seconds)), max(1, int(seconds)))

    def _mean(self, losses: dict[str, float]) -> dict[str, float]:
        """The processes' losses as those of the whole batch."""
        return dict(zip(losses, self.processes.mean(list(losses.values())), strict=True))

    def _save(self, learner: Learner, steps: int, about: dict[str, Any]) -> Path:
        if not self.processes.first:
            return self.out / INDEX
        spent = self.spent + self.clock.step_seconds - self.clock.first_seconds
        about = {**about, "step_seconds": round(spent, 2)}
        tensors = learner.tensors()
        # A step whose loss is finite may still have infinite gradients.
        wrong = next(
            (f"{role}, {name}" for role in tensors for name in not_finite(tensors[role])), None
        )
        if wrong is not None:
            found = f"NaN or infinite values in {wrong}"
            raise self._astray(learner, steps - 1, found, "finite weights")
        return save_checkpoint(self.out, steps, tensors, about)

    def _astray(self, learner: Learner, step: int, found: str, expected: str) -> TrainingError:
        kept = self.out / f"stopped-{step:07d}.safetensors"
        before = "the last checkpoint is kept" if (self.out / INDEX).exists() else "none was saved"
        if self.processes.first:
            self.out.mkdir(parents=True, exist_ok=True)
            save_tensors(kept, learner.batch(step))
        return TrainingError(
            self.out,
            field=f"step {step}",
            found=found,
            expected=expected,
            hint=f"Lower learning_rate and begin in another --out. {kept.name} holds the batch; of "
            f"checkpoints, {before}.",
        )

    def end(
        self,
        learner: Learner,
        steps: int,
        examples: int,
        score: ScoreT,
        samples: Sequence[Sample] = (),
    ) -> TrainResult[ScoreT]:
        """Save the trained network with its figures, and a sheet of some samples."""
        figures = {f.name: getattr(score, f.name) for f in dataclasses.fields(score)}
        shares = self.clock.shares()
        shares_logged = {f"share_{name}": round(share, 4) for name, share in shares.items()}
        self.log({"step": steps, **figures, **shares_logged})
        about = {**self.about, "metrics": figures}
        index = self._save(learner, steps, about)
        if samples and self.processes.first:
            title = f"{self.out.name} after {counted(steps, 'step')}"
            write_samples(self.out, title, score.sentence(), samples)
        seconds = time.monotonic() - self.began
        held_out = self.about["held_out"]
        return TrainResult(
            index,
            steps,
            self.first,
            seconds,
            self.clock.step_seconds,
            examples,
            held_out,
            score,
            shares,
        )

    def log(self, values: dict[str, Any]) -> None:
        """Add a line to the metrics."""
        if not self.processes.first:
            return
        self.out.mkdir(parents=True, exist_ok=True)
        line = {**values, "seconds": round(time.monotonic() - self.began, 2)}
        with (self.out / METRICS).open("a") as handle:
            handle.write(json.dumps(line) + "\n")
        if self.events is not None:
            scalars = {name: float(v) for name, v in values.items() if name != "step"}
            self.events.add(int(values["step"]), scalars)


def begin(
    out: Path,
    config: Any,
    store: Store,
    held_out: set[str],
    resume: bool,
    load: Callable[[Checkpoint], None],
    processes: Processes = ALONE,
    shadows: Path | None = None,
    other: Checkpoint | None = None,
) -> Run:
    """Begin a run in a folder, or resume the one that is there.

    Args:
        out: the folder.
        config: of the training.
        store: the data.
        held_out: people who are not trained on.
        resume: continue the run that is there.
        load: takes over the state of the checkpoint that is resumed.
        processes: that train together.
        shadows: folder of baked shadows that trainings share; None where each bakes its own.
        other: the run with whose weights this one begins.

    Raises:
        CheckpointError: nothing to resume, another configuration or other data; or, without
            `resume`, a run that is there already.
    """
    began, first, spent = time.monotonic(), 0, 0.0
    began_with = {} if other is None else other.files
    known = set(() if other is None else other.trained_on)
    if resume:
        if not (out / INDEX).exists():
            raise CheckpointError(
                out,
                found="no run",
                expected=f"a run with its {INDEX}",
                hint="Leave --resume out to begin one, or name the --out of the run to resume.",
            )
        checkpoint = read_checkpoint(out)
        require_same_run(checkpoint, config, store)
        load(checkpoint)
        first, spent = checkpoint.step, checkpoint.step_seconds
        began_with, known = checkpoint.began_with, set(checkpoint.trained_on)
    elif processes.first or (out / INDEX).exists():
        require_new(out, "Resume it with --resume, or choose another --out.")
    # Runs of an earlier version wrote what must not leave the lab.
    traces = {scan.sha256: scan.trace for scan in store.scans}
    known = {traces.get(each, each) for each in known}
    about = {
        "family": config.family,
        "config": as_dict(config),
        "data_fingerprint": store.fingerprint,
        "held_out": sorted(held_out),
        "texture_rows": config.rows_shown(store.scans[0].rows),
        "metrics": {},
        "trained_on": sorted(
            known | {scan.trace for scan in store.scans if scan.subject not in held_out}
        ),
    }
    if began_with:
        about["began_with"] = began_with
    return Run(
        out,
        config,
        about,
        first,
        began,
        spent,
        processes,
        EventFile(out),
        shadows=shadows,
        anew=not (resume or began_with),
    )


def not_better(score: Scored) -> str:
    """A warning where plain guesses are as good as the network; empty where they are not."""
    better = {name: db for name, db in score.guesses().items() if db >= score.psnr_db}
    if not better:
        return ""
    name = max(better, key=lambda guess: better[guess])
    return (
        f"on the people held out the network's {score.psnr_db:.2f} dB are no better than "
        f"{name} ({better[name]:.2f} dB): train longer or on more people; where more time does not "
        "help, lower learning_rate"
    )


def require_new(out: Path, hint: str) -> None:
    """Refuse a folder that a new run may not have.

    Args:
        out: the run's folder.
        hint: what to do where it holds a run.

    Raises:
        CheckpointError: it holds a run, or anything but what a run leaves.
    """
    if (out / INDEX).exists():
        raise CheckpointError(
            out / INDEX,
            found="a run that is there already",
            expected="an empty or a new folder",
            hint=hint,
        )
    others = others_in(out, OWN)
    if others:
        raise CheckpointError(
            out,
            found=f"{others[0]} and {len(others) - 1} more" if len(others) > 1 else others[0],
            expected="an empty or a new folder",
            hint="A run has a folder of its own; choose another --out.",
        )


def split(store: Store, held_out: int) -> tuple[set[str], set[str]]:
    """People held out (the last by name) and people trained on.

    Raises:
        TrainingError: not at least one of each, maps of several sizes, or one's scans in both.
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
            found=str(len(people)),
            expected=f"{held_out + 1} people or more: {held_out} held out, the others trained on",
            hint="Add people to the store, or lower held_out_subjects (at least 1); scans of one "
            "person all go to one side.",
        )
    apart, others = set(people[-held_out:]), set(people[:-held_out])
    require_other_scans(store, others, apart)
    return apart, others
