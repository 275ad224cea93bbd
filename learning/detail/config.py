"""Defaults of `detail`, and their bounds."""

from __future__ import annotations

RELIEF_MM = 60.0
"""Length of the waves of relief of which half is the mesh's: of longer ones more, of pores none."""
TIMES = 2
"""How often triangles are split into four."""
RELIEF_BOUNDS_MM = (3.0, 600.0)
MOST_TIMES = 4
