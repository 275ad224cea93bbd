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
from processing.separation.view_readings import Pixels


def matte_normals(
    signal: np.ndarray,
    brightness: np.ndarray,
    usable: np.ndarray,
    pixels: Pixels,
    lights: PatternLights,
    noise: float,
    config: SeparateConfig,
    shares: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Normals by the lights of the patterns, from where the pixels are, about.

    Args:
        signal: (n, P) readings of diffuse light.
        brightness: (n, P) mean channel, which sets the noise.
        usable: (n,) bool.
        pixels: whose views and places are taken.
        lights: of the P patterns.
        noise: standard deviation of the signal of a reading I over sqrt(.25 + I).
        config: iterations and trust.
        shares: (cells, P) what the camera gets of the irradiance of each normal; None for all.

    Returns:
        (n, 3) float64 unit normals, zero where unsolved; (n,) confidence.
    """
    views, points = pixels.views, pixels.points_mm
    vectors = far_field(lights)
    if shares is not None:
        vectors *= shares[:, :, None]
    normal = solve_far_normals(signal, vectors, views, config.iterations)
    normal[~usable] = 0
    cell = cells_of(normal)
    if points is not None:
        first, shadows = normal, no_shadows(len(signal), lights)
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
