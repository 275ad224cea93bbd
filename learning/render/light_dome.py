"""Directions spread evenly over a sphere, and spherical harmonics of them."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor


def even_directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors on a Fibonacci spiral, float64."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * np.pi * (3 - math.sqrt(5))
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), height, flat * np.sin(turn)], axis=1)


def harmonics(directions: Tensor, order: int) -> Tensor:
    """Real spherical harmonics up to an order, orthonormal over the sphere.

    Associated Legendre polynomials by their recurrences, cosines and sines of the azimuth by the
    angle's sum: polynomials of x, y, z, so the gradient is finite at the poles too.

    Args:
        directions: (..., 3) unit.
        order: highest band.

    Returns:
        (..., (order + 1)^2), bands one after the other, m from -l to l.
    """
    x, y, z = directions.unbind(-1)
    cosines, sines = [torch.ones_like(x)], [torch.zeros_like(x)]
    for _ in range(order):
        cosines.append(x * cosines[-1] - y * sines[-1])
        sines.append(x * sines[-1] + y * cosines[-2])
    # Legendre's polynomials over sin^m, which the cosines and sines above carry.
    legendre: dict[tuple[int, int], Tensor] = {}
    for m in range(order + 1):
        legendre[m, m] = torch.ones_like(z) * math.prod(range(1, 2 * m, 2))
        if m < order:
            legendre[m + 1, m] = (2 * m + 1) * z * legendre[m, m]
        for band in range(m + 2, order + 1):
            upper = (2 * band - 1) * z * legendre[band - 1, m]
            legendre[band, m] = (upper - (band + m - 1) * legendre[band - 2, m]) / (band - m)
    out = []
    for band in range(order + 1):
        for m in range(-band, band + 1):
            k = abs(m)
            size = (2 * band + 1) / (4 * math.pi)
            size *= math.factorial(band - k) / math.factorial(band + k)
            wave = sines[k] if m < 0 else cosines[k]
            scale = math.sqrt(size * (1 if m == 0 else 2))
            out.append(scale * legendre[band, k] * wave)
    return torch.stack(out, dim=-1)
