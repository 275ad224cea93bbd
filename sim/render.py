"""The simulator's own light transport: point lights on a Lambertian and microfacet surface.

Outgoing light of a surface point p, on a session's scale (a perfect white diffuser at the origin
facing +z under `full` reads 1), with w_i a light's weight (formats.environment), l_i the direction
to it, d_i its distance, d0_i its distance from the origin, V_i what the rays found:

    diffuse = albedo sum_i V_i w_i (n . l_i) (d0_i / d_i)^2
    specular = sum_i V_i w_i pi f(l_i, v) (n . l_i) (d0_i / d_i)^2,  f = D F G / (4 (n . l)(n . v))

D is Beckmann's distribution, G Smith's height-correlated masking, F the exact Fresnel reflectance
of a dielectric whose value at normal incidence is the specular albedo. What the mirror reflects is
not taken from what enters the skin: the albedo is exitant over incident for the light that entered.
"""

from __future__ import annotations

import math

import numba
import numpy as np

MIN_COSINE = 1e-4
"""Fine normals may turn from the camera where the surface does not; n . v is kept above this."""
MIN_DISTANCE2 = 1e-30
"""A light at the point itself has no direction and gives nothing."""


@numba.njit(cache=True, inline="always")
def fresnel_dielectric(f0: float, cosine: float) -> float:
    """Unpolarised reflectance of a dielectric, exact [CookTorrance1982].

    Args:
        f0: reflectance at normal incidence, 0..1 (clamped below 1).
        cosine: of the angle between the half vector and the light.
    """
    root = math.sqrt(min(max(f0, 0.0), 0.999))
    index = (1.0 + root) / (1.0 - root)
    g = math.sqrt(max(index * index - 1.0 + cosine * cosine, 0.0))
    minus, plus = g - cosine, g + cosine
    if plus <= 0.0:
        return 0.0
    first = minus / plus
    second = (cosine * plus - 1.0) / (cosine * minus + 1.0)
    return 0.5 * first * first * (1.0 + second * second)


@numba.njit(cache=True, inline="always")
def smith_lambda(cosine: float, roughness: float) -> float:
    """Smith's Lambda of Beckmann's distribution, rational fit [Walter2007]."""
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    if sine * roughness * 1.6 <= cosine:
        return 0.0
    a = cosine / (sine * roughness)
    return (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 * a + 2.181 * a * a)


@numba.njit(cache=True, parallel=True, fastmath={"contract", "reassoc", "nsz", "arcp"})
def shade_kernel(
    position: np.ndarray,
    geometric: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
    bits: np.ndarray,
    lit: np.ndarray,
    lights: np.ndarray,
    reference2: np.ndarray,
    weights: np.ndarray,
    diffuse_out: np.ndarray,
    specular_out: np.ndarray,
) -> None:
    """Light (s, n, 3) leaving n points under s states of m lights.

    All are float32: position, geometric, normal, view (n, 3); albedo (n, 3); specular and
    roughness (n,); lights (m, 3) mm; reference2 (m,) squared distance from the origin; weights
    (s, m, 3). bits (n, bytes) uint8 of all lights; lit (m,) int64, which of them these m are.
    """
    states, count = weights.shape[0], lights.shape[0]
    for i in numba.prange(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        vx, vy, vz = view[i, 0], view[i, 1], view[i, 2]
        n_v = max(nx * vx + ny * vy + nz * vz, np.float32(MIN_COSINE))
        m = max(roughness[i], np.float32(1e-3))
        m2 = m * m
        lambda_v = smith_lambda(n_v, m)
        for k in range(count):
            bit = lit[k]
            if not (bits[i, bit >> 3] >> (bit & 7)) & 1:
                continue
            lx, ly, lz = lights[k, 0] - px, lights[k, 1] - py, lights[k, 2] - pz
            d2 = lx * lx + ly * ly + lz * lz
            if not d2 > MIN_DISTANCE2:
                continue
            inverse = np.float32(1.0) / math.sqrt(d2)
            lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
            n_l = nx * lx + ny * ly + nz * lz
            g_l = geometric[i, 0] * lx + geometric[i, 1] * ly + geometric[i, 2] * lz
            # Written so that a NaN fails it too: such a point stays dark.
            if not (n_l > 0.0 and g_l > 0.0):
                continue
            falloff = reference2[k] * inverse * inverse
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            lobe = np.float32(0.0)
            if length > 1e-6:
                scale = np.float32(1.0) / length
                n_h = (nx * hx + ny * hy + nz * hz) * scale
                c2 = n_h * n_h
                if n_h > 0.0 and (1.0 - c2) < 16.0 * c2 * m2:
                    l_h = (lx * hx + ly * hy + lz * hz) * scale
                    d = math.exp((c2 - 1.0) / (c2 * m2)) / (m2 * c2 * c2)
                    g = 1.0 / (1.0 + lambda_v + smith_lambda(n_l, m))
                    # pi of the weight and 1 / pi of Beckmann's distribution cancel.
                    lobe = d * g * fresnel_dielectric(specular[i], l_h) / (4.0 * n_v)
            body = n_l * falloff
            lobe *= falloff
            for s in range(states):
                for c in range(3):
                    w = weights[s, k, c]
                    if w != 0.0:
                        diffuse_out[s, i, c] += w * body * albedo[i, c]
                        specular_out[s, i, c] += w * lobe


def shade(
    position: np.ndarray,
    geometric: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
    bits: np.ndarray,
    lights_mm: np.ndarray,
    weights: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Light that leaves surface points toward the camera.

    Args:
        position: (n, 3) mm, world.
        geometric: (n, 3) the mesh's unit normals: a light below their horizon gives nothing.
        normal: (n, 3) unit normals that shade.
        view: (n, 3) unit directions to the camera.
        albedo: (n, 3) diffuse albedo.
        specular: (n,) reflectance at normal incidence.
        roughness: (n,) Beckmann m.
        bits: (n, ceil(m / 8)) uint8, bit k & 7 of byte k >> 3 set where light k is seen.
        lights_mm: (m, 3) world.
        weights: (s, m, 3): for s states, what a white diffuser at the origin facing the light
            reads because of it (formats.environment).

    Returns:
        Diffuse and specular part, each (s, n, 3) float32.
    """
    lit = np.flatnonzero(np.asarray(weights).any(axis=(0, 2)))
    lights = np.asarray(lights_mm, float)[lit]
    reference2 = np.sum(lights**2, axis=1)
    shape = (len(weights), len(position), 3)
    diffuse_out, specular_out = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    surface = [position, geometric, normal, view, albedo, specular, roughness]
    shade_kernel(
        *(np.ascontiguousarray(a, np.float32) for a in surface),
        np.ascontiguousarray(bits, np.uint8),
        lit,
        lights.astype(np.float32),
        reference2.astype(np.float32),
        np.ascontiguousarray(np.asarray(weights)[:, lit], np.float32),
        diffuse_out,
        specular_out,
    )
    return diffuse_out, specular_out
