"""Display values of sRGB to linear light, and the space of linear colours."""

from __future__ import annotations

import numpy as np

XYZ_FROM_SRGB = np.array(
    [
        [0.4360747, 0.3850649, 0.1430804],
        [0.2225045, 0.7168786, 0.0606169],
        [0.0139322, 0.0971045, 0.7141733],
    ]
)
"""Linear sRGB to XYZ under D50, in which ICC profiles connect: the primaries and white of
[IEC61966], adapted by Bradford's matrix."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear red, green and blue in the luminance under D65 [IEC61966]."""


def linear_from_srgb(image_srgb: np.ndarray) -> np.ndarray:
    """Decode (...) sRGB in 0..1 to (...) linear values.

    Source: [IEC61966].
    """
    value = np.asarray(image_srgb)
    curve = np.power((np.maximum(value, 0.04045) + 0.055) / 1.055, 2.4)
    return np.where(value <= 0.04045, value / 12.92, curve)
