"""A run's metrics: one JSON object a line, of steps and of scores."""

from __future__ import annotations

from pathlib import Path

from lightstage.errors import FormatError
from lightstage.formats.files import write_bytes
from lightstage.formats.values import parse_json

METRICS, RATE = "metrics.jsonl", "learning_rate"
"""The file's name, and what every line of a step has among its losses."""
STEP, SECONDS = "step", "seconds"
"""What every line has beside its scalars."""


def drop_lost_lines(path: Path, first: int) -> bool:
    """Leave out of a run's metrics what is of no step that its checkpoint has.

    A training that was killed logged steps after its last checkpoint, which are taken again, and
    may have left half a line, to which the next one would be joined.

    Args:
        path: of the metrics, one JSON object a line.
        first: step with which the run is resumed.

    Returns:
        Whether there was any.
    """
    if not path.exists():
        return False
    lines = path.read_bytes().splitlines(keepends=True)
    kept = [line for line in lines if _is_before(line, first)]
    if len(kept) == len(lines):
        return False
    write_bytes(path, b"".join(kept))
    return True


def scores_at(path: Path, step: int) -> list[dict[str, float]]:
    """The scalars of the scores that a run's metrics have of a number of steps.

    Args:
        path: of the metrics, after `drop_lost_lines` with the same step.
        step: number of steps that were done.
    """
    lines = path.read_bytes().splitlines() if path.exists() else []
    read = [parse_json(line, METRICS) for line in lines]
    return [
        {
            name: float(value)
            for name, value in values.items()
            if name not in (STEP, SECONDS) and isinstance(value, int | float)
        }
        for values in read
        if values[STEP] == step
    ]


def _is_before(line: bytes, first: int) -> bool:
    """Whether a line of metrics is whole, and of a step before `first`, or of a score at it."""
    if not line.endswith(b"\n"):
        return False
    try:
        values = parse_json(line, METRICS)
        step = int(values[STEP])
    except (FormatError, ValueError, TypeError, KeyError):
        return False
    # Step N is logged once it is taken, and the score of N steps under N too.
    return step < first or (step == first and RATE not in values)
