"""Checks of maps before they are rendered: faults are refused, mended, or warned of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from learning.errors import MapsError
from lightstage.counting import counted
from lightstage.formats.mesh import Mesh

SMALLEST_HEAD_MM = 20.0
UNIT_OFF = 0.02
"""A normal's length may differ from 1 by this much: half floats and filtering do that."""
GREY_LEVELS = 255
FARTHEST_MM = 5.0
"""Median distance at which a map of positions is another head's or another template's."""
FARTHEST_DEG = 60.0
"""Median angle to the mesh's normals at which maps are another template's, or in other axes."""
OPPOSITE_DEG = 150.0
"""The same at which the mesh is inside out."""
INSIDE_OUT = "Is the mesh inside out? Reverse the order of its faces' corners."
CHECKED = 20_000
"""Texels that are compared with the mesh."""


def require_albedo(values: np.ndarray, path: Path) -> None:
    """MapsError where an albedo, or another map of shares, of any shape is negative."""
    bad = values < 0
    if bad.any():
        first = ", ".join(str(int(i)) for i in np.argwhere(bad)[0])
        raise MapsError(
            path,
            field=f"texel ({first})",
            found=f"{counted(int(bad.sum()), 'negative value')}, the lowest "
            f"{float(values.min()):.3g}",
            expected="values of at least 0",
            hint="Resampling with overshoot does this; clamp the map when it is made.",
        )


def require_millimetres(mesh: Mesh, where: str | Path) -> None:
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


def compared_texels(covered: np.ndarray) -> np.ndarray:
    """(k,) int32 flat indices of some of the (rows, columns) covered texels, evenly over them."""
    texels = np.flatnonzero(covered.ravel())
    # Loops over texels are compiled for this kind of array.
    return np.ascontiguousarray(texels[:: max(1, len(texels) // CHECKED)], np.int32)


def require_same_surface(
    maps: Mapping[str, np.ndarray],
    texels: np.ndarray,
    position_mm: np.ndarray,
    normals: np.ndarray,
    folder: Path,
    where: str | Path,
) -> None:
    """Refuse maps that were made on another mesh, by some texels that both have.

    Args:
        maps: (rows, columns, 3) by name; `position`, `diffuse_normal` and `specular_normal` are
            compared where they are there.
        texels: (k,) of `compared_texels`.
        position_mm: (k, 3) of the mesh at these.
        normals: (k, 3) unit, the mesh's at these.
        folder: of the maps.
        where: what to name the mesh in an error.

    Raises:
        MapsError: positions or normals that are another mesh's.
    """
    hint = "Give the mesh that the maps were made on, or the maps of this one."
    if "position" in maps:
        stored = maps["position"].reshape(-1, 3)[texels].astype(np.float64)
        known = (stored != 0).any(axis=1)
        off = np.linalg.norm(stored - position_mm, axis=1)[known]
        if off.size and np.median(off) > FARTHEST_MM:
            raise MapsError(
                folder / "position.exr",
                found=f"positions {np.median(off):.0f} mm from {where}, in the median",
                expected=f"the mesh's own, within {FARTHEST_MM:g} mm",
                hint=hint,
            )
    for name in ("diffuse_normal", "specular_normal"):
        if name not in maps:
            continue
        stored = maps[name].reshape(-1, 3)[texels].astype(np.float64)
        length = np.linalg.norm(stored, axis=1)
        known = length > 1e-3
        if not known.any():
            continue
        cosine = np.einsum("kc,kc->k", stored, normals)[known] / length[known]
        off_deg = float(np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))))
        if off_deg > FARTHEST_DEG:
            raise MapsError(
                folder / f"{name}.exr",
                found=f"normals {off_deg:.0f} degrees from those of {where}, in the median",
                expected=f"at most {FARTHEST_DEG:g}: maps of the mesh's own template, in its axes",
                hint=INSIDE_OUT if off_deg > OPPOSITE_DEG else hint,
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
