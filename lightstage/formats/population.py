"""A template's population: the mean head of people, and how they differ, beside its own mesh.

A template's mesh need not be anybody's mean. Where its folder has a population, which another head
model gave it (`lightstage-processing template population`), `fit` expects heads from there.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import atomic_path
from lightstage.formats.npz import UNREADABLE_NPZ
from lightstage.formats.surface_points import (
    FACE_SCHEME,
    SurfacePoints,
    file_name,
    read_surface_points,
    write_surface_points,
)

FILE = "population.npz"
POINTS_FILE = f"population_{file_name(FACE_SCHEME)}"


@dataclasses.dataclass(frozen=True)
class Population:
    """Heads of people in a template's topology and head frame.

    Attributes:
        mean_mm: (n, 3) vertices of the mean head.
        identity_mm: (k, n, 3) offsets, each of one standard deviation.
        licence: of the model that they are from.
        source: that model.
        face_points: where the face detector's points are on the mean head, where that is known.
            Detectors see them elsewhere on a head of another shape.
    """

    mean_mm: np.ndarray
    identity_mm: np.ndarray
    licence: str
    source: str
    face_points: SurfacePoints | None = None


def read_population(folder: Path, count: int) -> Population | None:
    """The population of a template's folder, or None where it has none.

    Args:
        folder: of the template.
        count: n, vertices of its mesh.

    Raises:
        FormatError: a file that is no population, or one of another mesh.
    """
    path = folder / FILE
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            mean = file["mean_mm"].astype(float)
            identity = file["identity_mm"].astype(float)
            licence, source = str(file["licence"]), str(file["source"])
    except UNREADABLE_NPZ as error:
        raise FormatError(
            path, found=str(error), expected="mean_mm, identity_mm, licence, source"
        ) from None
    if mean.shape != (count, 3):
        raise FormatError(
            path, field="mean_mm", found=f"shape {mean.shape}", expected=f"({count}, 3)"
        )
    if identity.ndim != 3 or identity.shape[1:] != (count, 3):
        raise FormatError(
            path, field="identity_mm", found=f"shape {identity.shape}", expected=f"(k, {count}, 3)"
        )
    for field, values in (("mean_mm", mean), ("identity_mm", identity)):
        if not np.isfinite(values).all():
            raise FormatError(
                path, field=field, found="NaN or infinity", expected="finite numbers, mm"
            )
    points = folder / POINTS_FILE
    return Population(
        mean,
        identity,
        licence,
        source,
        read_surface_points(points, count) if points.exists() else None,
    )


def write_population(population: Population, folder: Path) -> Path:
    """Write a population into a template's folder; returns the file.

    Points of another mean head that are there are removed where the new one has none.
    """
    path, points = folder / FILE, folder / POINTS_FILE
    if population.face_points is None:
        points.unlink(missing_ok=True)
    with atomic_path(path) as beside:
        np.savez_compressed(
            beside,
            mean_mm=population.mean_mm.astype(np.float32),
            # Half floats are right to .004 mm at 8 mm.
            identity_mm=population.identity_mm.astype(np.float16),
            licence=np.array(population.licence),
            source=np.array(population.source),
        )
    if population.face_points is not None:
        write_surface_points(population.face_points, points)
    return path
