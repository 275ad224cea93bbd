"""Perceived difference of two colours: CIELAB and its colour difference of the year 2000.

CIELAB is our own: colour-science rounds sRGB's matrix to four digits, as [IEC61966] prints it, and
that moves colours by up to .02.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

XYZ_FROM_RGB = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def lab_from_linear(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB.

    Args:
        rgb: (..., 3), white is (1, 1, 1).

    Returns:
        (..., 3) L* 0..100, a*, b*.
    """
    xyz = rgb @ (XYZ_FROM_RGB / XYZ_FROM_RGB.sum(axis=1, keepdims=True)).T
    edge = 6 / 29
    f = np.where(xyz > edge**3, np.cbrt(xyz), xyz / (3 * edge**2) + 4 / 29)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def delta_e_2000(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """CIEDE2000 between colours in CIELAB.

    Source: [Sharma2005].

    Args:
        one: (..., 3) L* a* b*.
        other: (..., 3), the same.

    Returns:
        (...); about 1 is just seen side by side; NaN where a colour is not finite.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(colour_science().delta_E(one, other, method="CIE 2000"))


def colour_science() -> Any:
    """The package colour-science, without what its import prints and sets.

    It takes more than a second to import, so only what needs it does so. It warns that it found no
    library for plots, and has NumPy print numbers as in version 1.13.
    """
    with warnings.catch_warnings(), np.printoptions():
        warnings.simplefilter("ignore")
        import colour
    return colour
