"""How much light skin's rough surface lets in and out, tabulated by our own integration.

T(c, m) = 1 - R(c, m), R the share that the facets of roughness m mirror of light from a direction
of cosine c: the hemispherical integral of the very lobe that `sim.light.render` draws, so that lobe
and diffuse part together reflect what a white skin receives and no more.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np

from sim.light.facets import (
    SKIN_INDEX,
    beckmann_lambda,
    fresnel_dielectric,
    ggx_lambda,
)

COSINES = 128
"""Steps of the table over the cosine, 0..1."""
ROUGHNESSES = 32
"""Steps of the table over the square root of m, 0..1, so that a smooth surface is resolved."""
MAX_ROUGHNESS = 1.0
"""A rougher surface lets in as much as this one."""
MIN_ROUGHNESS = 1e-3
"""A smoother surface is taken for this one, here and in `sim.light.render`."""
SLOPES, TURNS = 48, 32
"""Nodes of the integral over facets: their slope (Gauss-Legendre) and azimuth (midpoint)."""


@numba.njit(cache=True)
def mirrored_share(
    cosine: float, roughness: float, ggx: bool, nodes: np.ndarray, weights: np.ndarray, turns: int
) -> float:
    """Share of light from a direction that facets of n = 1.4 mirror, at one bounce.

    The integral runs over the facets' normals h, drawn as the distribution times their cosine,
    so that a narrow lobe needs no finer grid [Walter2007].

    Args:
        cosine: of the direction, above 0.
        roughness: m, above 0.
        ggx: GGX instead of Beckmann.
        nodes, weights: (k,) of the integral over 0..1 of the distribution's cumulative share.
        turns: azimuths over half a circle.
    """
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    if ggx:
        lambda_v = ggx_lambda(cosine, roughness * sine)
    else:
        lambda_v = beckmann_lambda(cosine, roughness * sine)
    total = 0.0
    for i in range(len(nodes)):
        u = nodes[i]
        squared = u / (1.0 - u) if ggx else -math.log(1.0 - u)
        n_h = 1.0 / math.sqrt(1.0 + roughness * roughness * squared)
        across = math.sqrt(max(0.0, 1.0 - n_h * n_h))
        ring = 0.0
        for j in range(turns):
            v_h = cosine * n_h + sine * across * math.cos(math.pi * (j + 0.5) / turns)
            n_l = 2.0 * v_h * n_h - cosine
            if v_h <= 0.0 or n_l <= 0.0:
                continue
            slope = roughness * math.sqrt(max(0.0, 1.0 - n_l * n_l))
            lambda_l = ggx_lambda(n_l, slope) if ggx else beckmann_lambda(n_l, slope)
            mirrored = fresnel_dielectric(SKIN_INDEX, v_h)
            ring += mirrored * v_h / (cosine * n_h * (1.0 + lambda_v + lambda_l))
        total += weights[i] * ring / turns
    return total


@numba.njit(cache=True, parallel=True)
def _fill(ggx: bool, nodes: np.ndarray, weights: np.ndarray, table: np.ndarray) -> None:
    rows, columns = table.shape
    for k in numba.prange(rows * columns):
        row, column = k // columns, k % columns
        roughness = max(MIN_ROUGHNESS, MAX_ROUGHNESS * (row / (rows - 1)) ** 2)
        # At cosine 0 the limit is what a direction just above the horizon meets.
        cosine = max(1e-4, column / (columns - 1))
        table[row, column] = 1.0 - mirrored_share(cosine, roughness, ggx, nodes, weights, TURNS)


@functools.cache
def transmittance_table(distribution: str = "beckmann") -> tuple[np.ndarray, np.ndarray]:
    """T and its mean, for linear interpolation.

    Args:
        distribution: ``beckmann`` or ``ggx``.

    Returns:
        (ROUGHNESSES + 1, COSINES + 1) float32 T at sqrt(m) and cosine in equal steps, and
        (ROUGHNESSES + 1,) float32 its mean over the hemisphere weighted by the cosine, exactly
        that of the interpolated table.
    """
    nodes, weights = np.polynomial.legendre.leggauss(SLOPES)
    table = np.zeros((ROUGHNESSES + 1, COSINES + 1))
    _fill(distribution == "ggx", (nodes + 1) / 2, weights / 2, table)
    c = np.arange(COSINES + 1) / COSINES
    low, high = table[:, :-1], table[:, 1:]
    # The integral of 2 c T over a step on which T is linear.
    mean = ((low * (2 * c[:-1] + c[1:]) + high * (c[:-1] + 2 * c[1:])) / 3 * np.diff(c)).sum(axis=1)
    return table.astype(np.float32), mean.astype(np.float32)


def transmittance(
    cosine: np.ndarray, roughness: np.ndarray, distribution: str = "beckmann"
) -> tuple[np.ndarray, np.ndarray]:
    """T and its cosine-weighted mean, interpolated as `sim.light.render` does.

    Args:
        cosine: (...) clamped to 0..1.
        roughness: (...) m, broadcast against `cosine`, clamped to 0..MAX_ROUGHNESS.
        distribution: ``beckmann`` or ``ggx``.

    Returns:
        T and its mean, each of the broadcast shape, float64.
    """
    table, mean = (part.astype(float) for part in transmittance_table(distribution))
    cosine, roughness = np.broadcast_arrays(np.asarray(cosine, float), np.asarray(roughness, float))
    across = np.clip(cosine, 0, 1) * COSINES
    down = np.sqrt(np.clip(roughness / MAX_ROUGHNESS, 0, 1)) * ROUGHNESSES
    column = np.minimum(across.astype(int), COSINES - 1)
    row = np.minimum(down.astype(int), ROUGHNESSES - 1)
    across, down = across - column, down - row
    top = table[row, column] * (1 - across) + table[row, column + 1] * across
    bottom = table[row + 1, column] * (1 - across) + table[row + 1, column + 1] * across
    return top * (1 - down) + bottom * down, mean[row] * (1 - down) + mean[row + 1] * down
