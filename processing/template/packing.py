"""One 0..1 tile for a mesh whose UV has several: the atlas's rows to columns are 3:2.

ICT's face becomes the upper 4096 x 4096 of 6144 x 4096 texels, its tile of the back of the head
the remaining 2048 x 4096. Smaller parts, which have tiles of their own there, go where those two
leave room.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from processing.atlas.raster import rasterise

ROWS, COLUMNS = 768, 512
"""Of the grid in which room is searched for."""
GAP = 2
"""Cells around a part that stay free: 16 texels at 6144 rows, the atlas's gutter."""
Tile = tuple[float, float, float, float]
"""Scale of u and v, and what is added to them."""
UPPER, LOWER = (1.0, 2 / 3, 0.0, 1 / 3), (1.0, 1 / 3, 0.0, 0.0)
"""Of the face's tile and of the one behind it."""
STEP = 0.93
"""Parts that find no room are made so much smaller until they do."""
SMALLEST = 0.02
"""Side of the smallest part's tile, as a share of the texture's width."""


def tile_of(uv: np.ndarray, where: Path, name: str) -> np.ndarray:
    """(2,) the tile in which all of (n, 2) texture coordinates are.

    Raises:
        FormatError: they are in several.
    """
    tile = np.floor((uv.min(axis=0) + uv.max(axis=0)) / 2)
    local = uv - tile
    if local.min() < -1e-6 or local.max() > 1 + 1e-6:
        raise FormatError(
            where,
            field=f"uv of {name}",
            found=f"{local.min():.3g} to {local.max():.3g} within a tile",
            expected="0 to 1",
        )
    return np.asarray(tile)


def packed(
    uvs: np.ndarray,
    triangle_uvs: np.ndarray,
    part: np.ndarray,
    area_mm2: np.ndarray,
    where: Path,
    names: list[str],
    tiles: tuple[Tile, Tile] = (UPPER, LOWER),
) -> np.ndarray:
    """UV of all parts in one tile.

    Args:
        uvs: (k, 2); a row belongs to one part.
        triangle_uvs: (t, 3) into them.
        part: (t,) of each triangle: 0 the face, 1 the head behind it, from 2 the small ones.
        area_mm2: (parts,) of each part's surface, by its number: how large its tile should be.
        where: the mesh's file, for errors.
        names: of the parts.
        tiles: where the tiles of the parts 0 and 1 go.

    Returns:
        (k, 2) in 0..1; rows that no triangle uses are 0.

    Raises:
        FormatError: a part's UV is in more than one tile, or there is no room.
    """
    out = np.zeros_like(uvs)
    free = np.ones((ROWS, COLUMNS), bool)
    boxes: list[tuple[int, np.ndarray, np.ndarray]] = []
    for number, name in enumerate(names):
        used = np.unique(triangle_uvs[part == number])
        if not len(used):
            continue
        local = uvs[used] - tile_of(uvs[used], where, name)
        if number < 2:
            su, sv, du, dv = tiles[number]
            out[used] = local * [su, sv] + [du, dv]
        else:
            low, high = local.min(axis=0), local.max(axis=0)
            boxes.append((number, used, (local - low) / np.maximum(high - low, 1e-9)))
    main = part < 2
    free &= rasterise(out, triangle_uvs[main], ROWS, COLUMNS).face < 0
    # A part's tile is as many texels as the face's for the same area, or less.
    face = np.ptp(out[np.unique(triangle_uvs[part == 0])], axis=0) * [COLUMNS, ROWS]
    density = np.prod(face) / area_mm2[0]
    times = 1.0
    while True:
        sides = {number: np.sqrt(times * density * area_mm2[number]) for number, *_ in boxes}
        places = _places(free, sides)
        if places is not None:
            break
        times *= STEP
        if min(sides.values()) < SMALLEST * COLUMNS:
            raise FormatError(
                where, field="uv", found="no room for eyes and mouth", expected="ICT's UV tiles"
            )
    for number, used, local in boxes:
        row, column, side = places[number]
        corner = np.array([column, ROWS - row - side])
        out[used] = (local * side + corner) / [COLUMNS, ROWS]
    return out


def _places(free: np.ndarray, sides: dict[int, float]) -> dict[int, tuple[int, int, int]] | None:
    """Top row, left column and side in cells of squares on free cells, the largest first."""
    left, places = free.copy(), {}
    for number in sorted(sides, key=lambda each: -sides[each]):
        side = int(sides[number])
        reach = side + 2 * GAP
        if reach > min(left.shape):
            return None
        total = np.zeros((ROWS + 1, COLUMNS + 1), np.int64)
        total[1:, 1:] = np.cumsum(np.cumsum(left, axis=0), axis=1)
        count = (
            total[reach:, reach:] - total[:-reach, reach:]
            - total[reach:, :-reach] + total[:-reach, :-reach]
        )  # fmt: skip
        rows, columns = np.nonzero(count == reach * reach)
        if not len(rows):
            return None
        row, column = int(rows[0]), int(columns[0])
        left[row : row + reach, column : column + reach] = False
        places[number] = (row + GAP, column + GAP, side)
    return places
