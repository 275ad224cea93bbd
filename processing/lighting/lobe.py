"""What a point reflects under each pattern: the Lambertian part and skin's mirror lobe.

A pattern k gives a point of albedo rho and specular albedo s the radiance rho E_k + s B_k: E_k its
irradiance, s B_k the microfacet lobe summed over the lights. The lobe is that of a dielectric of
n = 1.4, scaled so that it reflects s at normal incidence.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numba import njit, prange

from processing.lighting.facets import STEEPEST, horizontal, unmasked
from processing.lighting.fresnel import fresnel
from processing.lighting.interface import BARE, Interface, let_through, row_of
from processing.lighting.lights import (
    PatternLights,
    SeenLights,
    Shadows,
    as_seen,
    compiled,
    off_axis,
    seen_share,
)

SKIN_F0 = 0.028
"""Reflectance at normal incidence of skin, n = 1.4."""
FRESNEL_STEPS = 256
GRAZING = 0.05
"""Smallest cosine to the camera that the lobe is divided by."""


@functools.cache
def fresnel_table(rises: bool = True) -> np.ndarray:
    """(FRESNEL_STEPS + 1,) skin's F over its F at normal incidence, for cosines 0, 1/steps .. 1.

    Args:
        rises: of `Facets`; 1 everywhere where they do not.
    """
    if not rises:
        return np.ones(FRESNEL_STEPS + 1)
    return fresnel(SKIN_F0, np.linspace(0, 1, FRESNEL_STEPS + 1)) / SKIN_F0


def transport(
    lights: PatternLights,
    points_mm: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray | float,
    shadows: Shadows,
    interface: Interface = BARE,
) -> tuple[np.ndarray, np.ndarray]:
    """E_k and B_k of pixels.

    Args:
        lights: of P patterns.
        points_mm: (n, 3) surface points.
        normals: (n, 3) unit.
        views: (n, 3) unit, toward the camera.
        roughness: m, one or (n,).
        shadows: of the n points.
        interface: that light passes on its way into the diffuse layer and out, E_k holds both;
            its facets mirror.

    Returns:
        Two (n, P) float32.

    Source: [Walter2007] for the distributions and Smith's shadowing.
    """
    count = len(points_mm)
    out = np.zeros((2, count, len(lights.patterns)), np.float32)
    _transport(
        np.ascontiguousarray(points_mm, np.float32),
        np.ascontiguousarray(normals, np.float32),
        np.ascontiguousarray(views, np.float32),
        np.full(count, roughness, np.float32),
        compiled(lights, shadows),
        fresnel_table(interface.facets.rises).astype(np.float32),
        interface.table,
        interface.mean,
        interface.facets.shape,
        out,
    )
    as_seen(lights, normals, out[0], out[1])
    return out[0], out[1]


@njit(parallel=True, cache=True)
def _transport(
    points: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    roughnesses: np.ndarray,
    lights: SeenLights,
    table: np.ndarray,
    through: np.ndarray,
    mean: np.ndarray,
    shape: np.ndarray,
    out: np.ndarray,
) -> None:
    corners, weights, visible = lights.corners, lights.weights, lights.visible
    position, radius, weight = lights.position, lights.radius, lights.weight
    levels, group_end, exponent = lights.levels, lights.group_end, lights.exponent
    steps = len(table) - 1
    tails, stretch = shape[0] > 0, shape[1]
    for i in prange(len(points)):
        roughness = roughnesses[i]
        m2 = roughness * roughness
        mu2, mv2 = m2 * stretch * stretch, m2 / (stretch * stretch)
        farthest = np.float32(np.inf) if tails else np.float32(STEEPEST) * max(mu2, mv2)
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        vx, vy, vz = views[i, 0], views[i, 1], views[i, 2]
        nv = max(nx * vx + ny * vy + nz * vz, np.float32(GRAZING))
        tx, tz = horizontal(nx, nz)
        aside = tx * vx + tz * vz
        around = max(np.float32(0), 1 - nv * nv - aside * aside)
        shadow_v = unmasked(nv, math.sqrt(mu2 * aside * aside + mv2 * around), tails)
        row, part = row_of(roughness, len(through))
        leaving = let_through(through, row, part, nv)
        leaving /= mean[row] * (1 - part) + mean[row + 1] * part
        first = 0
        for group in range(len(group_end)):
            e = mirror = np.float32(0)
            for j in range(first, group_end[group]):
                seen = seen_share(corners[i], weights[i], visible, j)
                if seen <= 0:
                    continue
                lx = position[j, 0] - points[i, 0]
                ly = position[j, 1] - points[i, 1]
                lz = position[j, 2] - points[i, 2]
                nl = nx * lx + ny * ly + nz * lz
                if nl <= 0:
                    continue
                distance = math.sqrt(lx * lx + ly * ly + lz * lz)
                fall = radius[j] / distance
                seen *= weight[j] * fall * fall
                aside = position[j, 0] * lx + position[j, 1] * ly + position[j, 2] * lz
                seen *= off_axis(exponent, aside / (radius[j] * distance))
                nl /= distance
                e += seen * nl * leaving * let_through(through, row, part, nl)
                hx, hy, hz = lx / distance + vx, ly / distance + vy, lz / distance + vz
                length = math.sqrt(hx * hx + hy * hy + hz * hz)
                if length <= 0:
                    continue
                nh = (nx * hx + ny * hy + nz * hz) / length
                nh2 = nh * nh
                if nh <= 0 or (1 - nh2) > farthest * nh2:
                    continue
                aside = (tx * hx + tz * hz) / length
                around = max(np.float32(0), 1 - nh2 - aside * aside)
                steep = (aside * aside / mu2 + around / mv2) / nh2
                lobe = 1 / ((1 + steep) * (1 + steep)) if tails else math.exp(-steep)
                # pi D / (4 nv), the cosine to the light cancelled against the BRDF's.
                lobe /= 4 * m2 * nh2 * nh2 * nv
                aside = (tx * lx + tz * lz) / distance
                around = max(np.float32(0), 1 - nl * nl - aside * aside)
                slope = math.sqrt(mu2 * aside * aside + mv2 * around)
                lobe *= seen * shadow_v * unmasked(nl, slope, tails)
                place = min(1.0, (vx * hx + vy * hy + vz * hz) / length) * steps
                below = min(steps - 1, int(place))
                rest = place - below
                mirror += lobe * (table[below] * (1 - rest) + table[below + 1] * rest)
            first = group_end[group]
            for k in range(levels.shape[1]):
                out[0, i, k] += levels[group, k] * e
                out[1, i, k] += levels[group, k] * mirror
