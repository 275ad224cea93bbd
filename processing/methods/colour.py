"""Method `colour`: chroma's normals, specular albedo by least squares on skin's lobe."""

from __future__ import annotations

import numpy as np

from processing.albedo import diffuse_albedo, diffuse_light, pooled, shrunk, specular_evidence
from processing.lights import PatternLights, far_field, no_shadows
from processing.lobe import transport
from processing.methods.config import SeparateConfig
from processing.normals import solve_far_normals
from processing.pixels import PixelMaps
from processing.readings import read_pixels


def separate_pixels(
    rgb: np.ndarray,
    valid: np.ndarray,
    views: np.ndarray,
    mask: np.ndarray,
    lights: PatternLights,
    px_per_mm: float,
    config: SeparateConfig,
) -> PixelMaps:
    """Far-field separation of one view's pixels, each taken to lie at the sphere's centre.

    Normals come from chroma, which holds no mirror reflection; specular albedo from least squares
    on the lobe model, pooled over neighbours; diffuse albedo from what the lobe leaves.

    Args:
        rgb: (n, P, 3) what the mask's pixels read, in row order.
        valid: (n,) bool, false where clipped.
        views: (n, 3) unit, toward the camera.
        mask: (h, w) bool with n true pixels.
        lights: of the P patterns.
        px_per_mm: pixels a millimetre at the sphere's centre.
        config: see there.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark, grey or not finite.
    """
    rgb, signal, saturation, usable = read_pixels(rgb, valid, lights.colour, config.dark_level)
    normal = solve_far_normals(signal, far_field(lights), views, config.iterations)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    solved = usable & (colourful > 0) & (np.einsum("nk,nk->n", normal, normal) > 0.5)
    normal[~solved] = 0
    rgb = rgb / lights.colour.astype(np.float32)
    open_sky = no_shadows(len(rgb), lights)
    centre = np.zeros_like(normal)
    e, lobe = transport(lights, centre, normal, views, config.roughness, open_sky)
    each = specular_evidence(rgb.mean(axis=2), e, lobe)
    sigma = config.specular_pool_mm * px_per_mm
    weight = np.where(solved, each.weight, 0)
    typical = float(np.median(weight[solved])) if solved.any() else 0.0
    specular = shrunk(
        pooled(np.where(solved, each.weighed, 0), mask, sigma),
        pooled(weight, mask, sigma),
        config.specular_prior,
        config.specular_prior_share * typical,
    )
    specular = np.where(solved, specular, 0)
    lit, power = diffuse_light(rgb, e, lobe, specular)
    lit[~solved], power[~solved] = 0, 0
    albedo = diffuse_albedo(lit, power, mask, px_per_mm, config.albedo_prior_power)
    albedo[~solved] = 0
    facing = np.clip(np.einsum("nk,nk->n", normal, views) / 0.3, 0, 1)
    confidence = np.where(solved, colourful * facing * fit(signal, e), 0)
    roughness = np.where(solved, config.roughness, 0)
    return PixelMaps(normal, normal, albedo, specular, roughness, confidence)


def fit(signal: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """(n,) 0..1: how well the chroma follows the irradiance; shadows and clutter do not."""
    power = np.einsum("np,np->n", irradiance, irradiance)
    total = np.einsum("np,np->n", signal, signal)
    both = np.einsum("np,np->n", signal, irradiance)
    safe = np.where((power > 0) & (total > 0), power * total, 1)
    share = np.where((power > 0) & (total > 0), 1 - both * both / safe, 1)
    residual = np.sqrt(np.clip(share, 0, 1))
    return np.clip((0.4 - residual) / 0.3, 0, 1)
