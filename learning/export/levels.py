"""Levels of detail: the head with fewer triangles and smaller pictures, to be shown from far off.

Each level has a quarter of the triangles of the one before and pictures of half as many rows, so
that triangles and texels stay in proportion. Its normal map is made for its own mesh: what the
triangles lose of the shape, the normals still show.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from learning.export.source import Source, nearest_covered
from lightstage.errors import ConfigError
from lightstage.formats.mesh import vertex_normals
from lightstage.meshlab import decimated, reason_without
from processing.atlas.raster import rasterise
from processing.atlas.tangents import tangent_frames

TIMES = 4
"""Triangles of a level over those of the next."""
MOST = 6
FEWEST_TRIANGLES = 100
"""Of a level; fewer show no face."""


def require_levels(levels: int, programs: Sequence[str], formats: Sequence[str]) -> None:
    """Refuse levels that cannot be made.

    Args:
        levels: how many.
        programs: formats that levels are written in.
        formats: that are wanted.

    Raises:
        ConfigError: a number out of range, no format that has levels, or no pymeshlab.
    """
    if levels and not set(programs) & set(formats):
        raise ConfigError(
            "--lods",
            found=f"{levels}, with --format {','.join(formats)}",
            expected=f"some of {', '.join(programs)} in --format",
        )
    if not 0 <= levels <= MOST:
        raise ConfigError("--lods", found=str(levels), expected=f"0 to {MOST}")
    reason = reason_without() if levels else None
    if reason is not None:
        raise ConfigError("--lods", found=reason, expected="pymeshlab, which decimates")


def require_triangles(levels: int, triangles: int) -> None:
    """Refuse more levels than a mesh's triangles allow.

    Raises:
        ConfigError: the last one would have fewer than `FEWEST_TRIANGLES`.
    """
    last = triangles // TIMES**levels
    if levels and last < FEWEST_TRIANGLES:
        raise ConfigError(
            "--lods",
            found=f"{levels}, the last of {last} triangles",
            expected=f"levels of {FEWEST_TRIANGLES} triangles and more; the mesh has {triangles}",
        )


def coarser(source: Source) -> Source:
    """The next level of a head.

    Args:
        source: the head, or a level of it.

    Returns:
        Mesh and maps; maps are means of two by two texels, with the nearest skin beside islands.
    """
    mesh = decimated(source.mesh, len(source.mesh.triangles()) // TIMES)
    triangles, corners = mesh.triangles(), mesh.triangle_uvs()
    assert mesh.uvs is not None  # decimated keeps them
    normals = vertex_normals(mesh.vertices, triangles)
    rows, columns = (max(1, (side + 1) // 2) for side in source.size)
    raster = rasterise(mesh.uvs, corners, rows, columns)
    return dataclasses.replace(
        source,
        mesh=mesh,
        normals=normals,
        frames=tangent_frames(mesh.vertices, triangles, mesh.uvs, corners, normals),
        raster=raster,
        nearest=nearest_covered(raster.face >= 0),
        photo_mm=None,
        maps={
            name: _smaller(source.spread(image), rows, columns)
            for name, image in source.maps.items()
        },
    )


def on_level(source: Source, level: Source, offsets: np.ndarray) -> np.ndarray:
    """Offsets of a head's vertices at those of a level, by their place in the texture.

    Args:
        source: the head.
        level: of it.
        offsets: (n, 3) of the head's vertices.

    Returns:
        (m, 3) of the level's vertices.
    """
    assert level.mesh.uvs is not None
    vertex, first = np.unique(level.mesh.triangles().ravel(), return_index=True)
    uv = level.mesh.uvs[level.mesh.triangle_uvs().ravel()[first]]
    rows, columns = source.size
    row = np.clip(((1 - uv[:, 1]) * rows).astype(int), 0, rows - 1)
    column = np.clip((uv[:, 0] * columns).astype(int), 0, columns - 1)
    texels = source.nearest[row, column]
    out = np.zeros_like(level.mesh.vertices)
    out[vertex] = source.raster.at(offsets, source.mesh.triangles(), texels)
    return out


def _smaller(image: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """A map of half the size, by areas."""
    found = cv2.resize(image.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(found, np.float16)
