"""A coarse hull of what stereo cannot reconstruct: dark cloth without texture, a collar's back.

Space is divided into cells. A cell is empty where a camera sees the dark through it, or sees skin
or cloth behind it whose place is known. What is left, and shows in two photographs or more as
something whose place is not known, is filled: the visual hull [Laurentini1994], carved by what was
measured. It is larger than the thing itself, and never in front of the skin: good for shadows, and
not for anything else.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit, prange
from scipy import ndimage

from lightstage.formats.mesh import Mesh
from processing.closest import ClosestPoints
from processing.rays import MeshRays
from processing.readings import px_per_mm
from processing.reconstruction.fusion import compact
from processing.reconstruction.views import View

ROWS = 300
"""Silhouettes of at most so many rows: a cell is two or three of their pixels wide."""
CELL_MM = 3.0
"""Edge of a cell. With 2 mm shadows were no better, and the cells took four times the time."""
MOST_CELLS = 20_000_000
"""Cells are made larger where a mesh would need more."""
BEYOND_MM = 60.0
"""The hull ends so far from the meshes."""
KEEP_MM = 3.0
"""Least distance of the hull from the skin's mesh."""
CLOTH_MM = 4.0
"""Cloth that stereo found may be so far off: what is nearer in front of it is not carved."""
LEAST_VIEWS = 2
"""Views that show something unknown at a cell. One alone fills the whole space behind what it
shows: that took more light from skin than cloth does."""
LEAST_CM3 = 2.0
"""Smaller pieces are the rim of skin that cameras see too steeply to match."""
LEAST_SHARE = 0.02
"""Share of the foreground that the skin's mesh does not cover, below which nothing is searched.
It is under .013 where nothing is worn."""
MOST_SHARE = 0.9
"""A foreground that fills more of its picture has no outline, and shows nothing unknown."""
STEPPED = 1.5
"""Mean ratio of the area of cells' sides to that of a smooth surface that they follow."""


class Hull(NamedTuple):
    """What may cast shadows where nothing was measured.

    Attributes:
        mesh: sides of cells, outward, mm, world.
        area_cm2: of a smooth surface that they follow.
    """

    mesh: Mesh
    area_cm2: float


class Silhouette(NamedTuple):
    """What one view shows, in a picture of `ROWS` rows or fewer.

    Attributes:
        camera: (3, 4) pixel from world, and
        centre_mm: (3,) where it is.
        lit: (h, w) bool foreground.
        unknown: (h, w) bool, foreground whose place is not known.
        skin_mm: (h, w) float32, distance of the farthest skin in the pixels around; 0 for none.
        cloth_mm: (h, w) float32, distance of cloth that was measured; 0 for none.
        foot_px: a cell reaches so far from its middle.
    """

    camera: np.ndarray
    centre_mm: np.ndarray
    lit: np.ndarray
    unknown: np.ndarray
    skin_mm: np.ndarray
    cloth_mm: np.ndarray
    foot_px: int


def found_hull(views: Sequence[View], skin: Mesh, occluders: Mesh | None) -> Hull | None:
    """What the views show beside the skin and beside the occluders that were measured.

    Args:
        views: with their foregrounds; those without any are left out.
        skin: mm, world; the hull is nowhere in front of it, and `KEEP_MM` away from it.
        occluders: that stereo found, mm, world; None for none.

    Returns:
        The hull; None where there is nothing of any size, or fewer than two views.
    """
    shown = [view for view in views if view.mask.any()]
    if len(shown) < LEAST_VIEWS:
        return None
    around = [skin] if occluders is None else [skin, occluders]
    vertices = np.concatenate([mesh.vertices for mesh in around])
    low = vertices.min(axis=0) - BEYOND_MM
    size = vertices.max(axis=0) + BEYOND_MM - low
    cell_mm = max(CELL_MM, float(np.prod(size) / MOST_CELLS) ** (1 / 3))
    reach_mm = cell_mm * np.sqrt(3) / 2
    found = silhouettes(shown, skin, occluders, reach_mm)
    if found is None:
        return None
    counts = np.ceil(size / cell_mm).astype(int)
    cells = carved(found, low, cell_mm, (int(counts[0]), int(counts[1]), int(counts[2])))
    middles = low + cell_mm * (np.argwhere(cells) + 0.5)
    if not len(middles):
        return None
    away = ClosestPoints(skin.vertices, skin.triangles()).query(middles).distance_mm
    cells[cells] = away > KEEP_MM + reach_mm
    cells = larger(cells, LEAST_CM3 * 1000 / cell_mm**3)
    if not cells.any():
        return None
    mesh = sides_of(cells, low, cell_mm)
    return Hull(mesh, len(mesh.faces) * cell_mm**2 / 200 / STEPPED)


def silhouettes(
    views: Sequence[View], skin: Mesh, occluders: Mesh | None, reach_mm: float
) -> list[Silhouette] | None:
    """What the views show; None where the skin covers nearly all of it.

    Args:
        views: with some foreground each.
        skin: mm, world.
        occluders: that were measured; None for none.
        reach_mm: from a cell's middle to its corners.
    """
    rays = MeshRays(skin.vertices, skin.triangles())
    cloth = None if occluders is None else MeshRays(occluders.vertices, occluders.triangles())
    out, lit_px, bare_px = [], 0, 0
    for view in views:
        camera = view.camera.scaled(min(1.0, ROWS / view.camera.height_px))
        shape = (camera.height_px, camera.width_px)
        share = cv2.resize(view.mask.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA)
        lit = share > 0.5
        to_skin = rays.cast_camera(camera, lit).distance_mm.reshape(shape)
        to_cloth = np.full(shape, np.inf, np.float32)
        if cloth is not None:
            to_cloth = cloth.cast_camera(camera, lit).distance_mm.reshape(shape)
        # What is behind the skin was not seen there.
        is_skin = np.isfinite(to_skin) & (to_skin <= to_cloth)
        is_cloth = np.isfinite(to_cloth) & ~is_skin
        lit_px += int(lit.sum())
        near = cv2.dilate(np.isfinite(to_skin).astype(np.uint8), np.ones((3, 3), np.uint8))
        bare_px += int((lit & (near == 0)).sum())
        # A cell covers several pixels: it is in front of skin where any of them shows some.
        foot = 1 + int(np.ceil(reach_mm * px_per_mm(camera)))
        kernel = np.ones((2 * foot + 1, 2 * foot + 1), np.uint8)
        skin_mm = cv2.dilate(np.where(is_skin, to_skin, 0).astype(np.float32), kernel)
        unknown = lit & ~is_skin & ~is_cloth & (lit.mean() <= MOST_SHARE)
        lens = np.array(
            [[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]]
        )
        cloth_mm = np.where(is_cloth, to_cloth, 0).astype(np.float32)
        projection = lens @ np.asarray(camera.cam_from_world, float)
        out.append(Silhouette(projection, camera.centre_mm, lit, unknown, skin_mm, cloth_mm, foot))
    return out if bare_px >= LEAST_SHARE * lit_px else None


def carved(
    found: Sequence[Silhouette], low_mm: np.ndarray, cell_mm: float, counts: tuple[int, int, int]
) -> np.ndarray:
    """(x, y, z) bool: cells that no view shows to be empty, and two show to be unknown.

    Args:
        found: of each view; a depth that is not a number is none.
        low_mm: (3,) corner of the first cell.
        cell_mm: edge of a cell.
        counts: of cells along x, y, z.
    """
    height = max(one.lit.shape[0] for one in found)
    width = max(one.lit.shape[1] for one in found)

    def stacked(name: str, kind: type) -> np.ndarray:
        out = np.zeros((len(found), height, width), kind)
        for index, one in enumerate(found):
            values = getattr(one, name)
            out[index, : values.shape[0], : values.shape[1]] = values
        return out

    cells = np.zeros(counts, bool)
    _carve(
        cells,
        np.asarray(low_mm, float),
        float(cell_mm),
        np.stack([one.camera for one in found]).astype(float),
        np.stack([one.centre_mm for one in found]).astype(float),
        np.array([(*one.lit.shape, one.foot_px) for one in found], np.int64),
        stacked("lit", bool),
        stacked("unknown", bool),
        stacked("skin_mm", np.float32),
        stacked("cloth_mm", np.float32),
    )
    return cells


@njit(parallel=True, cache=True, error_model="numpy")
def _carve(
    cells: np.ndarray,
    low: np.ndarray,
    cell_mm: float,
    projections: np.ndarray,
    centres: np.ndarray,
    sizes: np.ndarray,
    lit: np.ndarray,
    unknown: np.ndarray,
    skin_mm: np.ndarray,
    cloth_mm: np.ndarray,
) -> None:
    reach = cell_mm * np.sqrt(3.0) / 2
    for i in prange(cells.shape[0]):
        x = low[0] + cell_mm * (i + 0.5)
        for j in range(cells.shape[1]):
            y = low[1] + cell_mm * (j + 0.5)
            for k in range(cells.shape[2]):
                z = low[2] + cell_mm * (k + 0.5)
                count, empty = 0, False
                for v in range(len(projections)):
                    p = projections[v]
                    depth = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
                    if not depth > 0:
                        continue
                    across = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / depth
                    down = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / depth
                    h, w, foot = sizes[v, 0], sizes[v, 1], sizes[v, 2]
                    if not (-foot <= across < w + foot and -foot <= down < h + foot):
                        continue
                    row = min(max(int(np.floor(down)), 0), h - 1)
                    column = min(max(int(np.floor(across)), 0), w - 1)
                    dx, dy, dz = x - centres[v, 0], y - centres[v, 1], z - centres[v, 2]
                    away = np.sqrt(dx * dx + dy * dy + dz * dz)
                    if away - reach < skin_mm[v, row, column]:
                        empty = True
                        break
                    # Of a cell whose middle is outside of the picture nothing else is known.
                    if not (0 <= across < w and 0 <= down < h):
                        continue
                    if not lit[v, row, column]:
                        empty = True
                        break
                    if away < cloth_mm[v, row, column] - CLOTH_MM:
                        empty = True
                        break
                    count += unknown[v, row, column]
                cells[i, j, k] = not empty and count >= LEAST_VIEWS


def larger(cells: np.ndarray, least: float) -> np.ndarray:
    """(x, y, z) bool: the pieces, connected by sides, that have so many cells."""
    piece, _ = ndimage.label(cells)
    large = np.bincount(piece.ravel()) >= least
    large[0] = False
    return np.asarray(large[piece])


def sides_of(cells: np.ndarray, low_mm: np.ndarray, cell_mm: float) -> Mesh:
    """The sides of (x, y, z) bool cells that no other cell shares, outward; mm, world.

    Args:
        cells: some of them true.
        low_mm: (3,) corner of the first cell.
        cell_mm: edge of a cell.
    """
    padded = np.pad(cells, 1)
    corners = np.array(padded.shape) + 1
    quads = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            beside = np.roll(padded, 1 - 2 * side, axis=axis)
            at = np.argwhere(padded & ~beside)
            ring = []
            for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = at.copy()
                corner[:, axis] += side
                corner[:, first] += a
                corner[:, second] += b
                ring.append(np.ravel_multi_index(tuple(corner.T), tuple(corners)))
            quads.append(np.stack(ring if side else ring[::-1], axis=1))
    four = np.concatenate(quads)
    used, four = np.unique(four, return_inverse=True)
    four = four.reshape(-1, 4)
    places = np.stack(np.unravel_index(used, tuple(corners)), axis=1) - 1
    faces = np.concatenate([four[:, :3], four[:, [0, 2, 3]]])
    return compact(np.asarray(low_mm, float) + cell_mm * places, faces)
