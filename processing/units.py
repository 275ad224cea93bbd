"""In which unit a head's mesh is, by its size: programs write mm, cm or metres."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SMALLEST_MM = 80.0
"""Largest side of a face's mesh, at least."""


class Unit(NamedTuple):
    """A unit of length.

    Attributes:
        name: as a message has it.
        mm: so many mm are one.
    """

    name: str
    mm: float


MM, CM, METRES = Unit("mm", 1.0), Unit("cm", 10.0), Unit("metres", 1000.0)


def likely_unit(vertices: np.ndarray) -> Unit:
    """The smallest of mm, cm and metres in which a mesh is large enough for a face.

    So a head or a body in metres is; a body in cm is as large as a head in mm, and taken for that.

    Args:
        vertices: (n, 3), finite; n at least 1.
    """
    side = largest_side(vertices)
    return next((unit for unit in (MM, CM) if side * unit.mm >= SMALLEST_MM), METRES)


def largest_side(vertices: np.ndarray) -> float:
    """Of the box along the axes that holds (n, 3) points; 0 without one."""
    return float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0


def axis_name(direction: np.ndarray) -> str:
    """Name of the axis nearest to (3,), such as +y."""
    axis = int(np.argmax(np.abs(direction)))
    return f"{'+' if direction[axis] >= 0 else '-'}{'xyz'[axis]}"
