"""Checks of maps before they are rendered: faults are refused, mended, or warned of."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from learning.errors import MapsError
from lightstage.counting import counted
from lightstage.formats.mesh import Mesh

SMALLEST_HEAD_MM = 20.0
UNIT_OFF = 0.02
"""A normal's length may differ from 1 by this much: half floats and filtering do that."""
GREY_LEVELS = 255


def require_albedo(values: np.ndarray, path: Path) -> None:
    """MapsError where an albedo of any shape is negative."""
    bad = values < 0
    if bad.any():
        first = ", ".join(str(int(i)) for i in np.argwhere(bad)[0])
        raise MapsError(
            path,
            field=f"texel ({first})",
            found=f"{counted(int(bad.sum()), 'negative value')}, the lowest "
            f"{float(values.min()):.3g}",
            expected="an albedo of at least 0",
            hint="Resampling with overshoot does this; clamp the map when it is made.",
        )


def require_millimetres(mesh: Mesh, where: str) -> None:
    """MapsError where a mesh is so small that its unit must be another one."""
    size = float(np.ptp(mesh.vertices, axis=0).max())
    if size < SMALLEST_HEAD_MM:
        raise MapsError(
            where,
            field="vertices",
            found=f"a head of {size:.3g}",
            expected=f"millimetres, more than {SMALLEST_HEAD_MM:g}",
            hint="Is the mesh in metres or centimetres? Multiply it by 1000 or 10.",
        )


def not_unit(normals: np.ndarray, covered: np.ndarray) -> int:
    """How many (rows, columns, 3) normals, where `covered`, have a direction but not length 1."""
    length = np.linalg.norm(normals[covered], axis=1)
    return int(((length > 1e-3) & (np.abs(length - 1) > UNIT_OFF)).sum())


def looks_encoded(albedo: np.ndarray, covered: np.ndarray) -> bool:
    """Whether a (rows, columns, 3) linear albedo looks like an 8-bit sRGB picture, not decoded.

    Such a picture's histogram has values at multiples of 1/255 alone. Half floats hold those to
    one part in 2048, so a level differs from its neighbours up to 1.
    """
    some = albedo[covered].astype(np.float64) * GREY_LEVELS
    if not some.size or some.max() > GREY_LEVELS + 0.1 or len(np.unique(some.round())) < 8:
        return False
    # Half a unit in the last place of a half float near 1 is 0.06 levels.
    return bool((np.abs(some - some.round()) < 0.07).mean() > 0.99)
