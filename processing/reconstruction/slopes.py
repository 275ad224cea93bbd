"""How inverse depth slopes in the picture where the surface has a known normal."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

STEEPEST = 0.15
"""Cosine to the line of sight below which a normal is bent toward the camera: a patch that is
seen at a more grazing angle has hardly any samples."""


def plane_slopes(normals: np.ndarray, lens: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Relative slopes of inverse depth of the planes that normals give.

    A plane's inverse depth is affine in the pixel: w(u + du, v + dv) = w (1 + a du + b dv).

    Args:
        normals: (h, w, 3) world; zero or NaN where unknown, read as facing the camera.
        lens: (4,) fx, fy, cx, cy.
        pose: (3, 4) cam_from_world.

    Returns:
        (h, w, 2) float32 a, b.
    """
    slopes = np.empty((*normals.shape[:2], 2), np.float32)
    turn = np.ascontiguousarray(pose[:, :3], np.float64)
    given = np.ascontiguousarray(normals, np.float32)
    _slopes(given, np.ascontiguousarray(lens, np.float64), turn, slopes)
    return slopes


@njit(cache=True, parallel=True)
def _slopes(normals: np.ndarray, lens: np.ndarray, turn: np.ndarray, slopes: np.ndarray) -> None:
    fx, fy, cx, cy = lens
    for row in prange(normals.shape[0]):
        y = (row + 0.5 - cy) / fy
        for column in range(normals.shape[1]):
            x = (column + 0.5 - cx) / fx
            far = math.sqrt(x * x + y * y + 1.0)
            sx, sy, sz = x / far, y / far, 1.0 / far
            n = normals[row, column]
            nx = n[0] * turn[0, 0] + n[1] * turn[0, 1] + n[2] * turn[0, 2]
            ny = n[0] * turn[1, 0] + n[1] * turn[1, 1] + n[2] * turn[1, 2]
            nz = n[0] * turn[2, 0] + n[1] * turn[2, 1] + n[2] * turn[2, 2]
            if not math.sqrt(nx * nx + ny * ny + nz * nz) > 0.5:
                nx, ny, nz = -sx, -sy, -sz
            facing = -(nx * sx + ny * sy + nz * sz)
            if facing < STEEPEST:
                bend = STEEPEST - facing
                nx, ny, nz = nx - bend * sx, ny - bend * sy, nz - bend * sz
            along = (nx * sx + ny * sy + nz * sz) * far
            slopes[row, column, 0] = nx / (fx * along)
            slopes[row, column, 1] = ny / (fy * along)
