"""Skin's surface as a rough dielectric: what its facets mirror, and what goes through to the skin.

The mirror lobe is Beckmann's distribution with Smith's height-correlated masking and the exact
reflectance of n = 1.4, scaled so that the specular albedo is the reflectance along the normal
[Walter2007]. The diffuse layer gets T(n . l) of a light and lets out T(n . v) / mean T, so that the
diffuse albedo is exitant over incident of what entered. T = 1 - R, where R is the share that the
facets mirror of light from one direction; R is a polynomial here, fitted to its integral.

The roughness m is the exponent's: m^2 = 2 / (s + 2).
"""

from __future__ import annotations

import torch
from torch import Tensor

INDEX = 1.4
"""Index of refraction of skin's surface, with which maps are measured."""
F0 = ((INDEX - 1) / (INDEX + 1)) ** 2
"""Its reflectance at normal incidence, .0278."""
LEAST_COSINE = 1e-4
"""Least cosine to the camera: normals of fine relief may turn away where the surface does not."""
SMOOTHEST, ROUGHEST = 0.1, 0.7
"""m that the polynomial was fitted for; T of smoother and rougher skin is that of these."""
MIDDLE = (ROUGHEST**0.5 + SMOOTHEST**0.5) / 2
HALF_RANGE = (ROUGHEST**0.5 - SMOOTHEST**0.5) / 2
MIRRORED = (
    (0.05935, -0.02629, 0.00180, 0.00893, -0.00512),
    (-0.07329, 0.07359, -0.04665, -0.01734, 0.03084),
    (0.06522, -0.05686, 0.04463, -0.03574, 0.01178),
    (-0.03826, -0.01568, 0.04945, 0.11954, -0.14297),
    (0.02561, 0.00224, -0.03513, -0.03267, 0.05565),
    (-0.01275, 0.06963, -0.07128, -0.16757, 0.18904),
    (0.00216, -0.04718, 0.05480, 0.12347, -0.14142),
)
"""R = sum of a[i][j] u^i x^j, u = 2 cos - 1 and x = (sqrt(m) - MIDDLE) / HALF_RANGE: within .002 of
the integral in the mean, .02 at grazing cosines below .05, by least squares."""


def roughness_of(exponent: Tensor) -> Tensor:
    """Roughness m of exponents of any shape."""
    return (2 / (exponent + 2)).sqrt()


def mirrored(roughness: Tensor) -> list[Tensor]:
    """What multiplies u^0, u^1 .. in R; each of the shape of `roughness`."""
    x = (roughness.clamp(SMOOTHEST, ROUGHEST).sqrt() - MIDDLE) / HALF_RANGE
    found = []
    for row in MIRRORED:
        total = torch.full_like(x, row[-1])
        for value in row[-2::-1]:
            total = total * x + value
        found.append(total)
    return found


def let_through(coefficients: list[Tensor], cosine: Tensor) -> Tensor:
    """T of cosines.

    Args:
        coefficients: of `mirrored`, each (B, 1, n).
        cosine: (B, L, n) or (B, 1, n), clamped to 0..1.

    Returns:
        Of the shape of `cosine`, 0..1.
    """
    u = 2 * cosine.clamp(0.0, 1.0) - 1
    total = coefficients[-1]
    for value in coefficients[-2::-1]:
        total = total * u + value
    return 1 - total


def mean_through(coefficients: list[Tensor]) -> Tensor:
    """The mean of T over the hemisphere, weighted by the cosine.

    Args:
        coefficients: of `mirrored`, each (B, 1, n).

    Returns:
        (B, 1, n).
    """
    total = torch.ones_like(coefficients[0])
    for i, value in enumerate(coefficients):
        # The integral of 2 c u^i over 0..1 is that of (u + 1) u^i / 2 over -1..1.
        total = total - value * (1 / (i + 1) if i % 2 == 0 else 1 / (i + 2))
    return total


def fresnel(cosine: Tensor) -> Tensor:
    """Exact unpolarised reflectance of n = 1.4, of cosines of any shape [CookTorrance1982]."""
    g = (INDEX**2 - 1 + cosine.square()).sqrt()
    minus, plus = g - cosine, g + cosine
    second = (cosine * plus - 1) / (cosine * minus + 1)
    return 0.5 * (minus / plus).square() * (1 + second.square())


def smith(cosine: Tensor, exponent: Tensor) -> Tensor:
    """Smith's Lambda of Beckmann's distribution, by a rational fit [Walter2007].

    Args:
        cosine: (B, L, n) or (B, 1, n), above 0.
        exponent: (B, 1, n), s.

    Returns:
        Of the shape of `cosine`.
    """
    sine = (1 - cosine.square()).clamp_min(1e-12).sqrt()
    a = cosine / sine * ((exponent + 2) / 2).sqrt()
    near = a.clamp_max(1.6)
    fitted = (1 - 1.259 * near + 0.396 * near.square()) / (3.535 * near + 2.181 * near.square())
    return torch.where(a < 1.6, fitted, torch.zeros_like(fitted))


def mirror_lobe(
    half: Tensor, incidence: Tensor, toward_view: Tensor, view_half: Tensor, exponent: Tensor
) -> Tensor:
    """Pi D F G / (4 n.v F0), on the scale where a white diffuser shows n . l.

    Args:
        half: (B, L, n) of L lights at n texels: n . h, 0..1.
        incidence: (B, L, n): n . l, clamped at 0.
        toward_view: (B, 1, n): n . v.
        view_half: (B, L, n): l . h, 0..1.
        exponent: (B, 1, n): s.

    Returns:
        (B, L, n).
    """
    steepness = (exponent + 2) / 2
    seen = toward_view.clamp(LEAST_COSINE, 1.0)
    lit = (half > 0) & (incidence > 0)
    h2 = torch.where(lit, half, torch.ones_like(half)).square()
    density = steepness * torch.exp(-steepness * (1 / h2 - 1)) / h2.square()
    masked = 1 + smith(seen, exponent) + smith(incidence.clamp(1e-6, 1.0), exponent)
    lobe = density * fresnel(view_half) / (4 * F0 * seen * masked)
    return torch.where(lit, lobe, torch.zeros_like(lobe))
