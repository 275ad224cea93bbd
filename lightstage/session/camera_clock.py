"""Whether a photograph is of its own shot, by the time that its camera wrote into it.

A camera gives its clock in whole seconds, and a file the time in whole seconds, mostly without its
zone. The clock may be hours off: what counts is its offset, read before. Computers' clocks are set
back at times, so a moment is carried from one reading to the next by the steady clock.
"""

from __future__ import annotations

import dataclasses
import datetime
import enum
import time

GRAIN_S = 3.0
"""A second each of the clock as it is read, of the time in the file, and of a camera that writes
the moment before the shutter."""
JUMP_S = 2.5
"""Two readings of one clock that differ by more are of a clock that was set in between."""
ZONE_S = 900.0
"""Time zones differ by whole quarters of an hour."""
FARTHEST_ZONE_S = 15 * 3600.0


class Verdict(enum.Enum):
    """Where the time in a photograph is from."""

    FITS = "it is of its shot"
    UNKNOWN = "the file has no time, or its clock may show another zone"
    DIFFERS = "it is of another moment, if nobody set the clock meanwhile"


@dataclasses.dataclass(frozen=True)
class CameraClock:
    """A camera's clock, as it was read at one moment.

    Attributes:
        offset_s: its time less this computer's.
        read_utc: this computer's time at the reading.
        read_s: time.monotonic() at the reading.
    """

    offset_s: float
    read_utc: datetime.datetime
    read_s: float

    @staticmethod
    def read_now(offset_s: float | None) -> CameraClock | None:
        """The clock whose offset was just read; None where the camera has none."""
        if offset_s is None:
            return None
        return CameraClock(offset_s, datetime.datetime.now(datetime.UTC), time.monotonic())

    def at(self, steady_s: float) -> datetime.datetime:
        """What it shows at a time of time.monotonic()."""
        return self.read_utc + datetime.timedelta(seconds=self.offset_s + steady_s - self.read_s)

    def offset_now_s(self) -> float:
        """Its time less this computer's, whose own clock may have been set since the reading."""
        now = datetime.datetime.now(datetime.UTC)
        return round((self.at(time.monotonic()) - now).total_seconds(), 3)

    def was_set_since(self, offset_s: float) -> bool:
        """Whether an offset that was just read is of a clock that was set since the reading."""
        return abs(offset_s - self.offset_now_s()) > JUMP_S


def judge_time(
    taken: datetime.datetime | None, begun: datetime.datetime, lasted_s: float
) -> Verdict:
    """Whether the time in a photograph is that of its shot.

    Args:
        taken: as in the file, with its zone or without; None where it has none.
        begun: by the camera's clock, when it was triggered.
        lasted_s: from then until the camera reported that the photograph was there.

    Returns:
        UNKNOWN also where it is whole quarters of an hour off: the clock shows another zone, or it
        is an old picture after all.
    """
    if taken is None:
        return Verdict.UNKNOWN
    zoned = taken if taken.tzinfo is not None else taken.replace(tzinfo=datetime.UTC)
    off_s = (zoned - begun).total_seconds()
    if -GRAIN_S <= off_s <= lasted_s + GRAIN_S:
        return Verdict.FITS
    # Counted from the middle of what fits, so that a long exposure fits in every zone.
    off_s -= lasted_s / 2
    beside_s = off_s - round(off_s / ZONE_S) * ZONE_S
    if abs(off_s) < FARTHEST_ZONE_S and abs(beside_s) <= lasted_s / 2 + GRAIN_S:
        return Verdict.UNKNOWN
    return Verdict.DIFFERS
