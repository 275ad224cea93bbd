"""What points are called: MediaPipe's 468, iBUG's 68 of them, and which of them the head hides."""

from __future__ import annotations

import numpy as np

from lightstage.faces.detect import Face
from lightstage.formats.surface_points import FACE_SCHEME

FACE_MESH = FACE_SCHEME
IBUG = "ibug68"
SCHEMES = (FACE_MESH, IBUG)
_JAW = [127, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 356]
_EYES = [33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380]
_LIPS = [61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181]
_INNER_LIPS = [78, 82, 13, 312, 308, 317, 14, 87]
IBUG_PAIRS = np.array(
    [
        *((i, i) for i in _JAW),
        # Brows: the mesh has a point above and one below each of iBUG's.
        *((46, 70), (53, 63), (52, 105), (65, 66), (55, 107)),
        *((285, 336), (295, 296), (282, 334), (283, 293), (276, 300)),
        # Ridge of the nose, then its base.
        *((168, 168), (6, 197), (5, 195), (4, 4)),
        *((75, 98), (97, 97), (2, 164), (326, 326), (305, 327)),
        *((i, i) for i in (*_EYES, *_LIPS, *_INNER_LIPS)),
    ]
)
"""(68, 2): each of iBUG's landmarks [Sagonas2016] is the mean of these two of the 468. The jaw's
are only near: the mesh has no points on the edge that a jaw shows to a camera."""
INNER_LIPS = slice(60, 68)
"""Their edge among iBUG's landmarks."""
FACING = 0.2
"""A point whose normal makes a smaller cosine with the line of sight is hidden by the head."""
NEIGHBOURS = 9
"""Points that determine a normal."""


def ibug68(points: np.ndarray) -> np.ndarray:
    """(68, k) iBUG's landmarks of (468, k) points, NaN where one of the two is NaN."""
    return np.asarray(points[IBUG_PAIRS].mean(axis=1))


def visible(face: Face) -> np.ndarray:
    """Which points the camera sees, as far as the face's own shape shows.

    The points with their depths are a relief of the face; its normals show what turns away. Hair
    and hands in front of it are not known of.

    Returns:
        (468,) bool.
    """
    relief = np.column_stack([face.points_px, face.depth_px])
    apart = np.linalg.norm(relief[:, None] - relief[None], axis=2)
    near = relief[np.argsort(apart, axis=1)[:, :NEIGHBOURS]]
    spread = near - near.mean(axis=1, keepdims=True)
    # The direction in which neighbours spread least.
    normal = np.linalg.svd(spread, full_matrices=False)[2][:, 2]
    outward = relief - relief.mean(axis=0) - _back(relief)
    normal *= np.where(np.einsum("nk,nk->n", normal, outward) < 0, -1.0, 1.0)[:, None]
    return np.asarray(-normal[:, 2] > FACING)


def _back(relief: np.ndarray) -> np.ndarray:
    """(3,) from the points' mean to the middle of the head: behind the face by half its height."""
    across = relief[263] - relief[33]
    down = relief[152] - relief[10]
    back = np.cross(across, down)
    length = max(float(np.linalg.norm(back)), 1e-9)
    return np.asarray(back / length * 0.5 * np.linalg.norm(down))


def seen_points(face: Face, scheme: str) -> np.ndarray:
    """A face's points in a scheme.

    Args:
        face: as detected.
        scheme: one of `SCHEMES`.

    Returns:
        (n, 2) pixels, NaN where the head hides the point.
    """
    points = np.where(visible(face)[:, None], face.points_px, np.nan)
    return ibug68(points) if scheme == IBUG else points
