"""How much of all directions a point on a mesh sees: what is in a cavity sees little."""

from __future__ import annotations

import numpy as np

from processing.rays import MeshRays

SKY_MM = 2000.0
SKY_DIRECTIONS = 100


def sky_share(rays: MeshRays, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Share of a hundred even directions that no triangle blocks.

    Args:
        rays: the mesh.
        points: (n, 3) on it, mm.
        normals: (n, 3) unit, outward.

    Returns:
        (n,) in 0..1; about .5 on a convex surface.
    """
    # A Fibonacci sphere: even directions without a random number.
    index = np.arange(SKY_DIRECTIONS) + 0.5
    z = 1 - 2 * index / SKY_DIRECTIONS
    angle = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z**2)
    sky = SKY_MM * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    centre = points.mean(axis=0) if len(points) else np.zeros(3)
    share: np.ndarray = rays.visible(points, normals, centre + sky).mean(axis=1)
    return share
