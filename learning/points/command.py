"""`template-points`: find the detector's points on a template, and write them."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from learning.points.find import find_points
from learning.points.paint import painted
from learning.points.pictures import Coloured, Lamp, camera_at, pictures_of
from lightstage.commands import ProgressCallback
from lightstage.formats.png import write_png
from lightstage.formats.population import POINTS_FILE
from lightstage.formats.surface_points import (
    FACE_SCHEME,
    SurfacePoints,
    file_name,
    write_surface_points,
)
from lightstage.formats.template import Template, load_template

SHOWN_YAWS_DEG = (-35.0, 0.0, 35.0)
FINER = 2.5
DOT_PX = 1
DOT = (0, 255, 0)


def template_points(
    path: Path, out: Path | None, picture: Path | None, progress: ProgressCallback
) -> dict[str, Any]:
    """Find and write a template's points, and those of its population's mean head.

    Args:
        path: the template's folder.
        out: the file for the mesh's points; where absent, all are written into the template's
            folder.
        picture: of the head with its points, or None; of the population's mean head where its
            points were found.
        progress: of views.

    Returns:
        Facts.

    Raises:
        LightstageError: no template, or one on which no face is seen.
    """
    began = time.monotonic()
    template = load_template(path)
    head = _head(template)
    points, counts = find_points(head, progress=progress)
    people, mean_points = template.population, None
    if people is not None and out is None:
        mean = dataclasses.replace(template, mesh=template.mesh.with_vertices(people.mean_mm))
        head = _head(mean)
        mean_points, _ = find_points(head, progress=progress)
        write_surface_points(mean_points, path / POINTS_FILE)
    written = write_surface_points(points, out or path / file_name(FACE_SCHEME))
    if picture is not None:
        write_png(picture, drawn(head, mean_points or points))
    there = points.triangles[:, 0] >= 0
    return {
        "points": str(written),
        "found": _found(points),
        "absent": len(there) - _found(points),
        "found_on_people": None if mean_points is None else _found(mean_points),
        "spread_median_mm": round(float(np.median(points.spread_mm[there])), 2),
        "spread_p90_mm": round(float(np.quantile(points.spread_mm[there], 0.9)), 2),
        **counts,
        "picture": None if picture is None else str(picture),
        "seconds": round(time.monotonic() - began, 1),
    }


def _found(points: SurfacePoints) -> int:
    """Count the points that have a place."""
    return int((points.triangles[:, 0] >= 0).sum())


def _head(template: Template) -> Coloured:
    """A template's mesh, coloured to be seen as a face."""
    middle = template.mesh.vertices[template.landmarks[17:]].mean(axis=0)
    return Coloured(template.mesh, painted(template), middle)


def drawn(head: Coloured, points: SurfacePoints) -> np.ndarray:
    """(h, w, 3) uint8: the head from three sides, with its points."""
    sides = []
    for yaw in SHOWN_YAWS_DEG:
        camera = camera_at(head.middle_mm, yaw, 0.0).scaled(FINER)
        shown = pictures_of(head, camera, [Lamp(10.0, 25.0, 0.5)])[0]
        for x, y in camera.project(points.on(head.mesh.vertices))[0]:
            if np.isfinite(x + y):
                column, row = int(x), int(y)
                rows = slice(max(0, row - DOT_PX), row + DOT_PX + 1)
                shown[rows, max(0, column - DOT_PX) : column + DOT_PX + 1] = DOT
        sides.append(shown)
    return np.concatenate(sides, axis=1)
