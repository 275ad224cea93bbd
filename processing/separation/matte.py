"""Diffuse normals of one view from the readings that hold diffuse light, and trust in them."""

from __future__ import annotations

import numpy as np

from processing.lighting.interface import skin_interface
from processing.lighting.lights import (
    PatternLights,
    cells_of,
    far_field,
    irradiance_vectors,
    no_shadows,
)
from processing.normals import solve_far_normals, solve_normals
from processing.separation.config import SeparateConfig
from processing.separation.trust import normal_trust
from processing.surface import Sight


def matte_normals(
    signal: np.ndarray,
    brightness: np.ndarray,
    usable: np.ndarray,
    views: np.ndarray,
    lights: PatternLights,
    noise: float,
    config: SeparateConfig,
    sight: Sight | None,
    shares: np.ndarray | None = None,
    points_mm: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Normals by the lights of the patterns, far away or where a mesh says the pixels lie.

    Args:
        signal: (n, P) readings of diffuse light.
        brightness: (n, P) mean channel, which sets the noise.
        usable: (n,) bool.
        views: (n, 3) unit, toward the camera.
        lights: of the P patterns.
        noise: standard deviation of the signal of a reading I over sqrt(.25 + I).
        config: iterations and trust.
        sight: what the camera sees of a mesh, None for lights far away.
        shares: (cells, P) what the camera gets of the irradiance of each normal; None for all.
        points_mm: (n, 3) where the pixels lie, about, where there is no mesh; None for the centre.

    Returns:
        (n, 3) float64 unit normals, zero where unsolved; (n,) confidence.
    """
    far = far_field(lights)
    if shares is not None:
        far *= shares[:, :, None]
    if sight is None:
        vectors, normal = far, solve_far_normals(signal, far, views, config.iterations)
        normal[~usable] = 0
        cell = cells_of(normal)
        points, shadows = points_mm, no_shadows(len(signal), lights)
    else:
        normal, points, shadows = sight.normals, sight.points_mm, sight.shadows
    if points is not None:
        first = normal
        for _ in range(2):
            vectors = irradiance_vectors(
                lights, points, normal, shadows, skin_interface(), config.roughness
            )
            if shares is not None:
                vectors *= shares[cells_of(normal)][:, :, None].astype(np.float32)
            normal = solve_normals(signal, vectors)
        agrees = np.einsum("nk,nk->n", normal, first) > 0
        normal[~(usable & agrees)] = 0
        cell = np.arange(len(normal))
    trust, _ = normal_trust(
        signal, brightness, vectors, cell, normal, views, noise, config.half_trust_deg
    )
    return normal, trust
