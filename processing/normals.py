"""Normals from what a pixel reads under each pattern."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit, prange

from processing.albedo import NARROWEST_PX
from processing.lighting.lights import OCTAHEDRON, octahedral_cell

ILL_POSED = 1e-4
"""A 3 x 3 system whose determinant is below this share of its mean diagonal cubed is not solved."""


def chroma_signal(rgb: np.ndarray, white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of RGB orthogonal to white, along each pixel's own hue.

    A mirror reflection has the light's colour, so that this part is diffuse alone; skin's is large.

    Args:
        rgb: (n, P, 3) what a pixel reads under P patterns.
        white: (3,) the lights' colour.

    Returns:
        (n, P) float32 signal, and (n,) float32 saturation: the chroma of the sum over patterns as a
        share of its mean channel; 0 where that is not positive or not finite.

    Source: [Mallick2005].
    """
    unit = (np.asarray(white) / np.linalg.norm(white)).astype(np.float32)
    signal = np.zeros(rgb.shape[:2], np.float32)
    saturation = np.zeros(len(rgb), np.float32)
    _chroma(np.ascontiguousarray(rgb, np.float32), unit, signal, saturation)
    return signal, saturation


@njit(parallel=True, cache=True)
def _chroma(rgb: np.ndarray, unit: np.ndarray, signal: np.ndarray, saturation: np.ndarray) -> None:
    for i in prange(len(rgb)):
        r = g = b = 0.0
        for k in range(rgb.shape[1]):
            r += rgb[i, k, 0]
            g += rgb[i, k, 1]
            b += rgb[i, k, 2]
        along = r * unit[0] + g * unit[1] + b * unit[2]
        x, y, z = r - along * unit[0], g - along * unit[1], b - along * unit[2]
        length = np.sqrt(x * x + y * y + z * z)
        mean = (r + g + b) / 3
        if not (length > 0 and mean > 0 and np.isfinite(length) and np.isfinite(mean)):
            continue
        saturation[i] = length / mean
        for k in range(rgb.shape[1]):
            signal[i, k] = (x * rgb[i, k, 0] + y * rgb[i, k, 1] + z * rgb[i, k, 2]) / length


@njit(cache=True)
def _solve(signal: np.ndarray, vectors: np.ndarray, out: np.ndarray) -> bool:
    """Least squares of signal_k = vectors_k . out; false when ill-posed or not finite."""
    a00 = a01 = a02 = a11 = a12 = a22 = r0 = r1 = r2 = 0.0
    for k in range(len(signal)):
        x, y, z = vectors[k, 0], vectors[k, 1], vectors[k, 2]
        a00 += x * x
        a01 += x * y
        a02 += x * z
        a11 += y * y
        a12 += y * z
        a22 += z * z
        r0 += x * signal[k]
        r1 += y * signal[k]
        r2 += z * signal[k]
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    det = a00 * c00 + a01 * c01 + a02 * c02
    scale = (a00 + a11 + a22) / 3
    if not det > ILL_POSED * scale * scale * scale:
        return False
    out[0] = (c00 * r0 + c01 * r1 + c02 * r2) / det
    out[1] = (c01 * r0 + c11 * r1 + c12 * r2) / det
    out[2] = (c02 * r0 + c12 * r1 + c22 * r2) / det
    return bool(np.isfinite(out[0] + out[1] + out[2]))


@njit(cache=True)
def _unit(vector: np.ndarray) -> float:
    """Scale a vector to length 1 in place; returns its length, 0 where it cannot be scaled."""
    length = float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))
    if not (length > 0 and np.isfinite(length)):
        vector[:] = 0
        return 0.0
    vector /= length
    return length


@njit(parallel=True, cache=True)
def solve_normals(signal: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Normals from known irradiance vectors: signal_k = vectors_k . (rho n), one 3 x 3 a pixel.

    Args:
        signal: (n, P) what the pixel reads, on any scale.
        vectors: (n, P, 3) irradiance vectors.

    Returns:
        (n, 3) float64 unit normals, zero where there is no solution (no light, not finite).
    """
    normals = np.zeros((len(signal), 3))
    for i in prange(len(signal)):
        if _solve(signal[i], vectors[i], normals[i]):
            _unit(normals[i])
        else:
            normals[i] = 0
    return normals


@njit(parallel=True, cache=True)
def solve_far_normals(
    signal: np.ndarray, table: np.ndarray, start: np.ndarray, iterations: int
) -> np.ndarray:
    """Normals in the far field, where the irradiance vectors depend on the normal's horizon alone.

    E_k(b) = b . g_k(b / |b|) is homogeneous and has the gradient g_k, so that solving the linear
    system again with the last normal's horizon is Gauss-Newton on b = rho n.

    Args:
        signal: (n, P).
        table: (cells, P, 3) of `lights.far_field`.
        start: (n, 3) first normals, such as the directions to the camera.
        iterations: linear solves.

    Returns:
        (n, 3) float64 unit normals, zero where there is no solution.
    """
    normals = start.astype(np.float64)
    for i in prange(len(signal)):
        for _ in range(iterations):
            n = normals[i]
            cell = octahedral_cell(n[0], n[1], n[2], OCTAHEDRON)
            if not (_solve(signal[i], table[cell], n) and _unit(n) > 0):
                n[:] = 0
                break
    return normals


def blurred(values: np.ndarray, good: np.ndarray, mask: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian means of a mask's pixels over their good neighbours.

    Args:
        values: (n, c) of the mask's pixels in row order.
        good: (n,) bool, pixels that count.
        mask: (h, w) bool with n true pixels.
        sigma_px: of the Gaussian.

    Returns:
        (n, c) float32, 0 where no neighbour is good.
    """
    image = np.zeros((*mask.shape, values.shape[1] + 1), np.float32)
    image[mask] = np.column_stack([values, np.ones(len(values))]) * good[:, None]
    border, sigma_px = cv2.BORDER_CONSTANT, max(sigma_px, NARROWEST_PX)
    planes = [cv2.GaussianBlur(p, (0, 0), sigma_px, borderType=border) for p in cv2.split(image)]
    weight = planes[-1][mask]
    safe = np.where(weight > 1e-6, weight, np.inf)
    return np.stack([plane[mask] / safe for plane in planes[:-1]], axis=1)


def ratio_normals(signal: np.ndarray, patterns: tuple[str, ...]) -> np.ndarray:
    """The published formula, n_a = (I_a+ - I_a-) / (I_a+ + I_a-), exact in a uniform field.

    Args:
        signal: (n, P).
        patterns: P names, with x+ x- y+ y- z+ z- among them.

    Returns:
        (n, 3) unit normals, zero where there is none.

    Source: [Kampouris2018].
    """
    index = {name: k for k, name in enumerate(patterns)}
    axes = []
    for axis in "xyz":
        plus, minus = signal[:, index[axis + "+"]], signal[:, index[axis + "-"]]
        total = plus + minus
        safe = np.where(total > 0, total, 1)
        axes.append(np.where(total > 0, (plus - minus) / safe, 0))
    vector = np.stack(axes, axis=1).astype(float)
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    good = np.isfinite(length) & (length > 0)
    return np.where(good, vector, 0) / np.where(good, length, 1)
