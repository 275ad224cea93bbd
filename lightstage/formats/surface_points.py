"""Named points on a mesh's surface, kept with a template: a triangle and three weights each."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import read_json, write_json

SCHEMA = "lightstage.surface_points/1"
FACE_SCHEME = "mediapipe468"
"""The face detector's points."""
COUNTS = {FACE_SCHEME: 468}
"""Points of each scheme."""
LEAST_WEIGHT = -1e-6
"""What rounding may leave of a weight that is zero."""


def file_name(scheme: str) -> str:
    """What a template's folder calls a scheme's points."""
    return f"{scheme}.json"


@dataclasses.dataclass(frozen=True)
class SurfacePoints:
    """Points that move with a mesh.

    Attributes:
        scheme: what the points are, by their order.
        triangles: (n, 3) int64 vertex indices; -1 where a point is not on the mesh.
        weights: (n, 3) of the three vertices, summing to 1; NaN there.
        spread_mm: (n,) how far the views that found a point are apart on it, NaN there.
    """

    scheme: str
    triangles: np.ndarray
    weights: np.ndarray
    spread_mm: np.ndarray

    def on(self, vertices: np.ndarray) -> np.ndarray:
        """(n, 3) the points on (v, 3) vertices of the mesh's topology; NaN where there is none."""
        out = np.full((len(self.triangles), 3), np.nan)
        there = self.triangles[:, 0] >= 0
        corners = np.asarray(vertices, float)[self.triangles[there]]
        out[there] = np.einsum("nc,nck->nk", self.weights[there], corners)
        return out


def read_surface_points(path: Path, vertex_count: int | None = None) -> SurfacePoints:
    """Read a template's points.

    Args:
        path: the file.
        vertex_count: of the mesh that they are for; not checked where absent.

    Raises:
        FormatError: another scheme, another count of points, indices beyond the mesh, weights that
            are no shares of a triangle.
    """
    value = read_json(path, SCHEMA)
    scheme = value.get("scheme")
    if not isinstance(scheme, str) or scheme not in COUNTS:
        expected = " or ".join(map(repr, COUNTS))
        raise FormatError(path, field="scheme", found=repr(scheme), expected=expected)
    count = COUNTS[scheme]
    lists = {name: value.get(name) for name in ("triangles", "weights", "spread_mm")}
    for name, entries in lists.items():
        if not isinstance(entries, list) or len(entries) != count:
            found = len(entries) if isinstance(entries, list) else type(entries).__name__
            raise FormatError(path, field=name, found=str(found), expected=f"{count} entries")
    triangles = np.full((count, 3), -1, np.int64)
    weights = np.full((count, 3), np.nan)
    spread = np.full(count, np.nan)
    most = np.iinfo(np.int32).max if vertex_count is None else vertex_count
    for index, entries in enumerate(zip(*lists.values(), strict=True)):
        if all(entry is None for entry in entries):
            continue
        corners, shares, apart = entries
        whole = isinstance(corners, list) and len(corners) == 3
        if not whole or not all(type(i) is int and 0 <= i < most for i in corners):
            expected = "three vertex indices" + (f" below {most}" if vertex_count else "")
            _refuse(path, f"triangles[{index}]", corners, expected)
        if not _numbers(shares, 3) or min(shares) < LEAST_WEIGHT or abs(sum(shares) - 1) > 1e-3:
            _refuse(path, f"weights[{index}]", shares, "three shares of 1")
        if not _numbers([apart], 1) or apart < 0:
            _refuse(path, f"spread_mm[{index}]", apart, "mm, 0 or more")
        triangles[index], weights[index], spread[index] = corners, shares, apart
    return SurfacePoints(scheme, triangles, weights, spread)


def write_surface_points(points: SurfacePoints, path: Path) -> Path:
    """Write a template's points; returns `path`."""
    there = points.triangles[:, 0] >= 0

    def entries(values: list[Any]) -> list[Any]:
        return [value if known else None for value, known in zip(values, there, strict=True)]

    return write_json(
        path,
        {
            "schema": SCHEMA,
            "scheme": points.scheme,
            "triangles": entries(points.triangles.tolist()),
            "weights": entries(np.round(points.weights, 6).tolist()),
            "spread_mm": entries(np.round(points.spread_mm, 3).tolist()),
        },
    )


def _numbers(values: object, count: int) -> bool:
    if not isinstance(values, list) or len(values) != count:
        return False
    return all(type(v) in (int, float) and np.isfinite(v) for v in values)


def _refuse(path: Path, field: str, found: object, expected: str) -> None:
    raise FormatError(path, field=field, found=repr(found), expected=expected)
