"""Albedo, gloss and specular normals of one view once its diffuse normals are known.

The lobe's width and the specular albedo are those that leave least of the readings unexplained,
pooled over neighbours; what the diffuse part leaves then shows which way the facets turn.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from processing.albedo import (
    Evidence,
    diffuse_albedo,
    diffuse_light,
    pooled,
    specular_evidence,
)
from processing.lighting.interface import BARE, skin_interface
from processing.lighting.lights import PatternLights, no_shadows
from processing.lighting.lobe import transport
from processing.normals import blurred
from processing.separation.config import LobeFitConfig
from processing.separation.lobe_table import lobe_table, table_lobe
from processing.separation.mirror import mirror_normals
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps

MOST_SPECULAR = 0.2
"""Reflectances above are metals, not faces."""


def maps_by_lobe(
    pixels: Pixels,
    rgb: np.ndarray,
    normal: np.ndarray,
    trust: np.ndarray,
    lights: PatternLights,
    mirror: PatternLights,
    noise: float,
    relief: str,
    config: LobeFitConfig,
    shares: np.ndarray | None = None,
) -> PixelMaps:
    """Maps of one view's pixels.

    Args:
        pixels: whose views, mask and places are taken.
        rgb: (n, P, 3) their readings, white where the lights are; finite.
        normal: (n, 3) unit diffuse normals, zero where unsolved.
        trust: (n,) confidence.
        lights: of the P patterns.
        mirror: the same as mirror reflection shows them to this camera.
        noise: standard deviation of a reading I over sqrt(.25 + I).
        relief: what specular normals are: ``mirror``, ``detail`` or ``diffuse``.
        config: see there.
        shares: (n, P) what the camera gets of the irradiance; None for all.

    Returns:
        PixelMaps, zero where there is no normal.
    """
    views, mask, px_per_mm = pixels.views, pixels.mask, pixels.px_per_mm
    solved = np.einsum("nk,nk->n", normal, normal) > 0.5
    if not solved.any():
        zeros = np.zeros_like(normal)
        nothing = np.zeros(len(normal))
        return PixelMaps(zeros, zeros, zeros, nothing, nothing, nothing)
    points = pixels.places_mm
    interface = BARE if pixels.camera is None else skin_interface()
    m = config.roughness[len(config.roughness) // 2]
    sky = no_shadows(len(rgb), lights)
    e, _ = transport(lights, points, normal, views, m, sky, interface)
    if shares is not None:
        e = e * shares
    table = lobe_table(mirror, views[solved].mean(axis=0), config.roughness)
    mean = rgb.mean(axis=2)
    weight = 1 / np.sqrt(_variance(mean, mean, noise, config))

    def lobe_of(m: np.ndarray | float) -> np.ndarray:
        return table_lobe(table, points, normal, views, m)

    roughness, specular = _gloss(mean, e, weight, lobe_of, solved, mask, px_per_mm, config)
    lit, power = diffuse_light(rgb, e, lobe_of(roughness), specular)
    lit[~solved], power[~solved] = 0, 0
    albedo = diffuse_albedo(lit, power, mask, px_per_mm, config.albedo_prior_power)
    matte = e * albedo.mean(axis=1)[:, None]
    facets = normal
    if relief != "diffuse":
        sigma = np.sqrt(_variance(mean, matte, noise, config))
        seen = (points, normal, views)
        found = mirror_normals(mean - matte, sigma, table, *seen, roughness, config.mirror)
        facets = found.normal
    if relief == "detail":
        facets = with_detail(normal, facets, solved, mask, config.detail_mm * px_per_mm)
    flat = (specular, roughness, trust)
    specular, roughness, confidence = (np.where(solved, x, 0) for x in flat)
    albedo[~solved] = 0
    return PixelMaps(normal, facets, albedo, specular, roughness, confidence)


def with_detail(
    base: np.ndarray, relief: np.ndarray, solved: np.ndarray, mask: np.ndarray, sigma_px: float
) -> np.ndarray:
    """Normals with the relief of others: base + relief - blurred relief, unit.

    Args:
        base, relief: (n, 3) unit.
        solved: (n,) bool where both are.
        mask: (h, w) bool with n true pixels.
        sigma_px: finer than this is relief.

    Source: [Ma2007] for hybrid normals.
    """
    apart = relief - base
    vector = base + apart - blurred(apart, solved, mask, sigma_px)
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    good = solved[:, None] & (length > 1e-6)
    return np.where(good, vector / np.where(good, length, 1), 0)


def _variance(
    reading: np.ndarray, matte: np.ndarray, noise: float, config: LobeFitConfig
) -> np.ndarray:
    """Variance of a reading's mean channel: of the sensor, and of what the model is wrong by."""
    sensor = noise**2 * (0.25 + np.maximum(reading, 0)) / 3
    return np.asarray(sensor + (config.model_error * np.maximum(matte, 0)) ** 2)


def _gloss(
    mean: np.ndarray,
    e: np.ndarray,
    weight: np.ndarray,
    lobe_of: Callable[[float], np.ndarray],
    solved: np.ndarray,
    mask: np.ndarray,
    px_per_mm: float,
    config: LobeFitConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) lobe width and (n,) specular albedo that explain the neighbourhood best."""
    wide, near = config.roughness_pool_mm * px_per_mm, config.specular_pool_mm * px_per_mm
    layers = []
    left = []
    for m in config.roughness:
        found = specular_evidence(mean * weight, e * weight, lobe_of(m) * weight)
        found = Evidence(
            *(np.where(solved, x, 0) for x in (found.weighed, found.weight, found.power))
        )
        top, bottom, power = (
            pooled(x, mask, wide) for x in (found.weighed, found.weight, found.power)
        )
        left.append(power - top**2 / np.maximum(bottom, 1e-30))
        layers.append(found)
    grid = np.array(config.roughness)
    roughness = _hollow(grid, np.stack(left))
    below = np.clip(np.searchsorted(grid, roughness) - 1, 0, len(layers) - 2)
    part = (roughness - grid[below]) / (grid[below + 1] - grid[below])
    at = np.arange(len(mean))
    weighed, power = (
        stack[below, at] * (1 - part) + stack[below + 1, at] * part
        for stack in (
            np.stack([x.weighed for x in layers]),
            np.stack([x.weight for x in layers]),
        )
    )
    prior = config.specular_prior_share * float(np.median(power[solved]))
    top = pooled(weighed, mask, near) + config.specular_prior * prior
    bottom = pooled(power, mask, near) + prior
    specular = np.where(bottom > 0, top / np.where(bottom > 0, bottom, 1), config.specular_prior)
    return roughness, np.clip(specular, 0, MOST_SPECULAR)


def _hollow(grid: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """(n,) the lowest point of parabolas through (M, n) residuals, within the grid."""
    curve, slope, _ = np.polyfit(grid, residual, 2)
    best = grid[np.argmin(residual, axis=0)]
    inside = curve > 0
    best = np.where(inside, -slope / np.where(inside, 2 * curve, 1), best)
    return np.asarray(np.clip(best, grid[0], grid[-1]))
