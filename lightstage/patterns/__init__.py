"""Light patterns: names, the user's own, the levels they are driven with, their pictures."""

from lightstage.patterns.drive import Drive, drive_levels, split_emitters
from lightstage.patterns.names import (
    MEANINGS,
    SEQUENCES,
    complement,
    on_plane,
    pattern_levels,
    sequence_patterns,
)
from lightstage.patterns.own import UserPattern, read_patterns
from lightstage.patterns.weights import light_weights

__all__ = [
    "MEANINGS",
    "SEQUENCES",
    "Drive",
    "UserPattern",
    "complement",
    "drive_levels",
    "light_weights",
    "on_plane",
    "pattern_levels",
    "read_patterns",
    "sequence_patterns",
    "split_emitters",
]
