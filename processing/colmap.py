"""pycolmap, imported so that signals go on to end a command as `lightstage.interrupts` says.

At its import glog puts a handler of its own onto SIGTERM, beneath Python's: the process would end
at once with a stack trace of C++, and no `finally` would run.
"""

from __future__ import annotations

from lightstage.interrupts import handlers_kept

with handlers_kept():
    import pycolmap

__all__ = ["pycolmap"]
