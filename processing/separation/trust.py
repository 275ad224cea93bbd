"""How far a pixel's normal can be believed: what noise leaves open, and whether the readings fit.

Noise that is harmless on light skin is amplified wherever the readings that a normal is solved from
are weak: chroma of an eye's white, of teeth or grey hair is a few per cent of its brightness. Such
pixels are ill-posed for colour and get little confidence, by the same figure as dark ones.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

POSED = 1e-9
"""A system whose determinant is below this share of its mean diagonal cubed is not solved."""
GRAZING_SHARE = 0.3
"""Confidence falls with the cosine to the camera below this."""


def normal_trust(
    signal: np.ndarray,
    brightness: np.ndarray,
    vectors: np.ndarray,
    cell: np.ndarray,
    normal: np.ndarray,
    views: np.ndarray,
    noise: float,
    half_trust_deg: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Confidence in normals that were solved by least squares of signal_k = g_k . b.

    Args:
        signal: (n, P) readings that the normals were solved from.
        brightness: (n, P) what the photographs read there, mean channel.
        vectors: (m, P, 3) irradiance vectors.
        cell: (n,) which of them is each pixel's.
        normal: (n, 3) unit, zero where unsolved.
        views: (n, 3) unit, toward the camera.
        noise: standard deviation of the signal of a reading I over sqrt(.25 + I).
        half_trust_deg: of the normal's standard deviation that halves the confidence.

    Returns:
        (n,) float32 confidence 0..1, 0 where unsolved or not finite; (n,) float32 standard
        deviation of the normal in radians, as far as noise alone makes it; infinite where unsolved.
    """
    trust = np.zeros(len(signal), np.float32)
    sigma = np.full(len(signal), np.inf, np.float32)
    _trust(
        np.ascontiguousarray(signal, np.float64),
        np.ascontiguousarray(brightness, np.float64),
        np.ascontiguousarray(vectors, np.float64),
        np.ascontiguousarray(cell, np.int64),
        np.ascontiguousarray(normal, np.float64),
        np.ascontiguousarray(views, np.float64),
        noise,
        math.radians(half_trust_deg),
        trust,
        sigma,
    )
    return trust, sigma


@njit(parallel=True, cache=True)
def _trust(
    signal: np.ndarray,
    brightness: np.ndarray,
    vectors: np.ndarray,
    cell: np.ndarray,
    normal: np.ndarray,
    views: np.ndarray,
    noise: float,
    half_trust: float,
    trust: np.ndarray,
    sigma: np.ndarray,
) -> None:
    for i in prange(len(signal)):
        x, y, z = normal[i, 0], normal[i, 1], normal[i, 2]
        facing = x * views[i, 0] + y * views[i, 1] + z * views[i, 2]
        if not (x * x + y * y + z * z > 0.5 and facing > 0):
            continue
        g = vectors[cell[i]]
        a00 = a01 = a02 = a11 = a12 = a22 = 0.0
        power = both = total = bright = 0.0
        for k in range(signal.shape[1]):
            p, q, r = g[k, 0], g[k, 1], g[k, 2]
            a00 += p * p
            a01 += p * q
            a02 += p * r
            a11 += q * q
            a12 += q * r
            a22 += r * r
            e = p * x + q * y + r * z
            power += e * e
            both += e * signal[i, k]
            total += signal[i, k] * signal[i, k]
            bright += max(brightness[i, k], 0.0) / signal.shape[1]
        if not (power > 0 and both > 0 and math.isfinite(total + bright)):
            continue
        c00, c11, c22 = a11 * a22 - a12 * a12, a00 * a22 - a02 * a02, a00 * a11 - a01 * a01
        det = a00 * c00 - a01 * (a01 * a22 - a12 * a02) + a02 * (a01 * a12 - a11 * a02)
        scale = (a00 + a11 + a22) / 3
        if not det > POSED * scale * scale * scale:
            continue
        # b = |b| n: noise across n turns it by its size over |b|, along n it does not.
        variance = (c00 + c11 + c22) / det / 3 * noise * noise * (0.25 + bright)
        length = both / power
        sigma[i] = math.sqrt(variance) / length
        residual = math.sqrt(max(0.0, 1 - both * both / (power * total)))
        fits = min(max((0.4 - residual) / 0.3, 0.0), 1.0)
        share = sigma[i] / half_trust
        trust[i] = fits * min(1.0, facing / GRAZING_SHARE) / (1 + share * share)
