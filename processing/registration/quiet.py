"""A scan's noise reduced before anything is fitted to it."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh
from processing.registration.laplacian import neighbour_mean
from processing.registration.target import Target, border_vertices

MOST = 2.0
"""A vertex moves at most so many standard deviations of the noise: no relief above it is lost."""


def quieted(scan: Mesh, rounds: int) -> Mesh:
    """The scan with its vertices moved along their normals, where they stand out from both rings.

    Each round subtracts B B v, B = (I - mean of neighbours) / 2: it takes what alternates from
    vertex to vertex and leaves what bends evenly, which one B alone would flatten [Taubin1995].

    Args:
        scan: triangles, mm.
        rounds: how often.

    Returns:
        A mesh of the same triangles; borders stay.
    """
    triangles = scan.triangles()
    target = Target(scan)
    if rounds < 1 or not len(target.triangles):
        return scan
    limit = MOST * target.noise_mm()
    mean = neighbour_mean(target.triangles, len(scan.vertices))
    stays = border_vertices(target.triangles, len(scan.vertices))
    stays[np.setdiff1d(np.arange(len(stays)), target.triangles)] = True
    normals = target.normals
    away = np.zeros(len(scan.vertices))
    for _ in range(rounds):
        moved = scan.vertices + away[:, None] * normals
        for _ in range(2):
            moved = 0.5 * (moved - mean @ moved)
        away = np.clip(away - np.einsum("nk,nk->n", moved, normals), -limit, limit)
        away[stays] = 0
    return Mesh(scan.vertices + away[:, None] * normals, triangles)
