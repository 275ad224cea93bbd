"""A coarse solid of what stands beside the skin: where no camera sees past it.

Stereo finds no depth in smooth cloth, in its back, in hair. Silhouettes and the skin bound it: a
place is taken for filled where every camera that looks there sees something in front of the dark
[Laurentini1994], none sees the skin or a matched surface behind it, and several see neither skin
nor dark. What no camera looks at is taken for empty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera
from processing.closest import ClosestPoints
from processing.rays import MeshRays

CELL_MM = 4.0
"""Side of a cell."""
AROUND_MM = 90.0
"""So far beside the skin's box cells are looked at."""
SEEN_BY = 2
"""So many cameras at least must see something there that is no skin."""
BEFORE_MM = 3.0
"""A cell that lies so far before a seen surface is empty."""
OFF_SKIN_MM = 6.0
"""Cells nearer to the skin would shadow it where it is only roughly known."""
LEAST_CELLS = 160
"""Smaller pieces are chance: this is 10 cm^3."""


def filled_cells(
    cameras: Sequence[Camera],
    foregrounds: Sequence[np.ndarray],
    skin: Mesh,
    matched: Mesh | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Which cells are filled.

    Args:
        cameras: of the views, of the size of their pictures.
        foregrounds: (h, w) bool of each.
        skin: mm, world.
        matched: surfaces beside the skin that several views agree on; None for none.

    Returns:
        (a, b, c) bool, and (3,) mm the middle of the first cell.
    """
    low = skin.vertices.min(axis=0) - AROUND_MM
    shape = np.ceil((skin.vertices.max(axis=0) + AROUND_MM - low) / CELL_MM).astype(int) + 1
    places = low + CELL_MM * np.stack(np.indices(tuple(shape)), axis=-1).reshape(-1, 3)
    filled = np.ones(len(places), bool)
    seen = np.zeros(len(places), np.int32)
    rays = MeshRays(skin.vertices, skin.triangles())
    others = None if matched is None else MeshRays(matched.vertices, matched.triangles())
    for camera, foreground in zip(cameras, foregrounds, strict=True):
        skin_mm = _distances(rays, camera)
        other_mm = _distances(others, camera) if others else np.full_like(skin_mm, np.inf)
        pixel, _ = camera.project(places)
        height, width = foreground.shape
        inside = (pixel >= 0).all(axis=1) & (pixel < [width, height]).all(axis=1)
        column, row = pixel[inside].astype(int).T
        far = np.linalg.norm(places[inside] - camera.centre_mm, axis=1)
        nearest = np.minimum(skin_mm, other_mm)[row, column]
        there = foreground[row, column] & ~((nearest < np.inf) & (far < nearest - BEFORE_MM))
        filled[inside] &= there
        seen[inside] += foreground[row, column] & (skin_mm[row, column] == np.inf)
    filled &= seen >= SEEN_BY
    some = np.flatnonzero(filled)
    near = ClosestPoints(skin.vertices, skin.triangles()).query(places[some]).distance_mm
    filled[some[near < OFF_SKIN_MM]] = False
    return filled.reshape(tuple(shape)), low


def _distances(rays: MeshRays, camera: Camera) -> np.ndarray:
    """(h, w) mm from a camera to a mesh, infinite beside it."""
    found = rays.cast_camera(camera).distance_mm
    return np.asarray(found.reshape(camera.height_px, camera.width_px))


def hull(
    cameras: Sequence[Camera],
    foregrounds: Sequence[np.ndarray],
    skin: Mesh,
    matched: Mesh | None,
) -> Mesh | None:
    """The filled cells' outer faces, as triangles that look outward; None where none is filled.

    Arguments as `filled_cells`.
    """
    filled, low = filled_cells(cameras, foregrounds, skin, matched)
    label, count = ndimage.label(filled)
    size = np.bincount(label.ravel(), minlength=count + 1)
    filled &= size[label] >= LEAST_CELLS
    return boxes(filled, low, CELL_MM)


def boxes(filled: np.ndarray, low_mm: np.ndarray, side_mm: float) -> Mesh | None:
    """The faces between filled and empty cells; (a, b, c) bool, the first cell's middle at low."""
    padded = np.pad(filled, 1)
    corners, quads = [], []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for sign in (1, -1):
            bare = padded & ~np.roll(padded, -sign, axis=axis)
            middle = np.argwhere(bare).astype(float) - 1
            middle[:, axis] += 0.5 * sign
            ring = np.zeros((4, 3))
            ring[:, others] = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            # (axis, others) is a right-handed frame but where the others lie around the axis.
            turned = (sign > 0) == (axis != 1)
            corners.append((middle[:, None] + (ring if turned else ring[::-1])).reshape(-1, 3))
    all_corners = np.concatenate(corners)
    if not len(all_corners):
        return None
    unique, index = np.unique(np.round(2 * all_corners).astype(int), axis=0, return_inverse=True)
    quads = index.reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return Mesh(low_mm + side_mm * unique / 2, triangles)
