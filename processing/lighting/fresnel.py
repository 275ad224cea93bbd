"""How much light a smooth dielectric mirrors."""

from __future__ import annotations

import numpy as np


def fresnel(f0: np.ndarray | float, cosine: np.ndarray) -> np.ndarray:
    """Exact unpolarised reflectance of a dielectric.

    Args:
        f0: (...) reflectance at normal incidence, 0..1, broadcast against `cosine`.
        cosine: (...) of the angle of incidence, 0..1.

    Returns:
        (...) reflectance, 0..1.

    Source: [BornWolf1999].
    """
    root = np.sqrt(f0)
    index = (1 + root) / (1 - root)
    c = np.asarray(cosine, float)
    g = np.sqrt(index**2 - 1 + c**2)
    first = ((g - c) / (g + c)) ** 2
    second = ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2
    return np.asarray(0.5 * first * (1 + second))
