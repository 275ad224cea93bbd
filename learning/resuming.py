"""Whether a run can be resumed: its configuration at the start, beside the present one."""

from __future__ import annotations

import json
from typing import Any

from learning.checkpoint import INDEX, Checkpoint
from learning.errors import CheckpointError
from lightstage.formats.config import as_dict
from lightstage.formats.values import parse_json
from processing.dataset import Store

FREE = ("seconds", "precision", "compile", "save_seconds", "log_steps")
"""Configuration that may differ when a run is resumed: how long, how fast, and what is written."""
MOST_NAMED = 4
"""Values that differ from those a run began with, at most, that a message names."""


def require_same_run(checkpoint: Checkpoint, config: Any, store: Store) -> None:
    """Refuse to resume a run that began with another configuration or other data.

    Args:
        checkpoint: the run's last one.
        config: of the training that is to be resumed.
        store: its data.

    Raises:
        CheckpointError: what differs.
    """
    where = checkpoint.folder / INDEX
    if checkpoint.family != config.family:
        raise CheckpointError(
            where,
            field="family",
            found=f"{checkpoint.family}, as the run began",
            expected=f"{config.family}, the given preset's",
            hint="Resume with the --preset that the run began with, or choose another --out.",
        )
    wanted = parse_json(json.dumps(as_dict(config)), "configuration")
    differing = {
        name: values
        for name, values in _differences(checkpoint.config, wanted).items()
        if name not in FREE
    }
    if differing:
        named = list(differing)[:MOST_NAMED]
        more = f" and {len(differing) - len(named)} more" if len(differing) > len(named) else ""
        raise CheckpointError(
            where,
            field=", ".join(named) + more,
            found=", ".join(str(differing[name][1]) for name in named) + " now",
            expected=", ".join(str(differing[name][0]) for name in named) + ", as the run began",
            hint="Resume with the same --preset, --config and --seed.",
        )
    if checkpoint.data_fingerprint != store.fingerprint:
        raise CheckpointError(
            where,
            field="data_fingerprint",
            found=f"{store.fingerprint[:12]} now, of {store.path}",
            expected=f"{checkpoint.data_fingerprint[:12]}, as the run began",
            hint="Resume with the --data that the run began with, or choose another --out.",
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
