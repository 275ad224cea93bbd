"""The message of an interrupted training: the step that is kept, and how to resume."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from learning.checkpoint import INDEX, read_checkpoint
from learning.processes import Processes
from lightstage.errors import StoppedError
from lightstage.resume_line import shell_line


def stopped_training(
    out: Path,
    options: Mapping[str, object],
    processes: Processes,
    begin_with: str | None = None,
) -> StoppedError:
    """The last words of an interrupted `train`.

    Args:
        out: the run's folder.
        options: that the command was given, by name; those that are None were not.
        processes: that trained together.
        begin_with: the option --begin-with, of which a run that is resumed has no need.

    Raises:
        CheckpointError, FormatError: the run's checkpoint is damaged.
    """
    words = ["lightstage-learning"]
    if processes.count > 1:
        words = ["torchrun", "--nproc-per-node", str(processes.count), "-m", "learning"]
    words.append("train")
    for name, value in options.items():
        words += [] if value is None else [name, str(value)]
    if not (out / INDEX).exists():
        words += [] if begin_with is None else ["--begin-with", begin_with]
        return StoppedError(
            f"Interrupted before the first checkpoint: no step is kept in {out}. "
            f"Begin again with: {shell_line(*words)}"
        )
    kept = f"step {read_checkpoint(out).step} is kept in {out}"
    return StoppedError(f"Interrupted: {kept}. To resume: {shell_line(*words, '--resume')}")
