"""Defaults of `detail`, and their bounds."""

from __future__ import annotations

RELIEF_MM = 10.0
"""Size above which relief is the mesh's, not the normals'."""
TIMES = 2
"""How often triangles are split into four."""
RELIEF_BOUNDS_MM = (0.5, 100.0)
MOST_TIMES = 4
