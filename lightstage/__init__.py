"""The light stage itself: lights, cameras, sessions; and the floor that every package imports."""

import os
from pathlib import Path

from lightstage.compiled import keep_apart

__version__ = "0.1.0"

# Numba tries TBB first and warns where an older one is found (some libraries bring theirs).
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp workqueue tbb")
keep_apart(Path(__file__).resolve().parents[1])
