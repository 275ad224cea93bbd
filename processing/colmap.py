"""pycolmap, imported so that signals still end a command as `lightstage.interrupts` has it.

At its import glog puts a handler of its own onto SIGTERM, beneath Python's: the process would end
at once with a stack trace of C++, and no `finally` would run.
"""

from __future__ import annotations

from lightstage.interrupts import handlers_kept

with handlers_kept():
    import pycolmap

__all__ = ["pycolmap"]
