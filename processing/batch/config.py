"""Settings of `lightstage-processing batch`, table [batch] of its --config."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from lightstage.formats.config import make_config, require_bounds


@dataclasses.dataclass(frozen=True)
class BatchConfig:
    """When a batch gives something up.

    Attributes:
        tries: how often a stage is begun whose worker dies, hangs or runs out of memory, at most.
        stalled_s: a stage that reports no progress for so long hangs, and its worker is killed. At
            24 megapixels a stage reports progress at least every five minutes.
        busy_s: so long a folder is waited for that another run or batch holds.
        answer_s: so long a scheduler may take to answer when it is connected to.
        away_s: the batch waits so long for its first worker, and for a scheduler that is away.
        page_every_s: batch.html is written again so often, and at the end.
        memory_share: of the memory that is free when the batch begins, the share to be used.
        stands_out: of a figure, the robust z from which it counts as an outlier among all sessions;
            3.5 as in [IglewiczHoaglin1993].
    """

    tries: int = 3
    stalled_s: float = 1800.0
    busy_s: float = 3600.0
    answer_s: float = 10.0
    away_s: float = 300.0
    page_every_s: float = 30.0
    memory_share: float = 0.8
    stands_out: float = 3.5

    def __post_init__(self) -> None:
        """Refuse numbers outside their bounds."""
        bounds = {
            "tries": (1.0, 100.0),
            "stalled_s": (1.0, 1e6),
            "busy_s": (0.0, 1e6),
            "answer_s": (0.1, 1e6),
            "away_s": (1.0, 1e6),
            "page_every_s": (1.0, 1e6),
            "memory_share": (0.05, 1.0),
            "stands_out": (0.5, 100.0),
        }
        require_bounds(self, "[batch]", bounds)


@dataclasses.dataclass(frozen=True)
class _Table:
    batch: BatchConfig = dataclasses.field(default_factory=BatchConfig)


def take_batch(values: dict[str, Any], where: str | Path) -> BatchConfig:
    """Take the table [batch] out of a TOML file's values; the others are the stages'.

    Args:
        values: the file's tables by name.
        where: what errors name.

    Raises:
        ConfigError: an unknown key, a value of another type or outside its bounds, no table.
    """
    return make_config(_Table, {"batch": values.pop("batch", {})}, where).batch
