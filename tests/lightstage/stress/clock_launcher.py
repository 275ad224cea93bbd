"""`python clock_launcher.py OFFSET_FILE ARGUMENTS`: lightstage under a clock that is set.

The clock is this machine's, less the seconds in OFFSET_FILE, read anew each time somebody asks: as
if the computer's clock were set while the program runs. Nobody else's clock is touched.
"""

from __future__ import annotations

import datetime
import sys
import time
from pathlib import Path

OFFSET = Path(sys.argv.pop(1))
_REAL_TIME = time.time


def offset_s() -> float:
    """Seconds by which the clock is off now."""
    return float(OFFSET.read_text() or 0)


class SetClock(datetime.datetime):
    """datetime whose `now` is the set clock's."""

    @classmethod
    def now(cls, tz=None):
        return cls.fromtimestamp(_REAL_TIME() + offset_s(), tz)


if __name__ == "__main__":
    datetime.datetime = SetClock
    time.time = lambda: _REAL_TIME() + offset_s()
    from lightstage.__main__ import main

    main()
