"""A view's readings before anything is solved: which pixels can be used, and their chroma."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from lightstage.rig import Camera
from processing.normals import chroma_signal

BRIGHTEST = 1e12
"""No lamp makes a reading like this, and its powers are no float32."""


def read_pixels(
    rgb: np.ndarray, valid: np.ndarray, white: np.ndarray, dark_level: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sort out the pixels that cannot be solved, and take chroma from the others.

    Args:
        rgb: (n, P, 3) readings.
        valid: (n,) bool, false where clipped.
        white: (3,) the lights' colour.
        dark_level: see SeparateConfig.

    Returns:
        (n, P, 3) float32 readings, 0 where a pixel is not usable; (n, P) and (n,) signal and
        saturation of `chroma_signal`; (n,) bool usable: valid, finite, every channel alive, and
        brighter than `dark_level` under some pattern.
    """
    clean = np.array(rgb, np.float32, order="C")
    usable = valid.copy()
    _sort_out(clean, usable, dark_level)
    signal, saturation = chroma_signal(clean, white)
    return clean, signal, saturation, usable


@njit(parallel=True, cache=True)
def _sort_out(rgb: np.ndarray, usable: np.ndarray, dark_level: float) -> None:
    """Zero the pixels that are not usable, in place."""
    for i in prange(len(rgb)):
        least = np.inf
        brightest = 0.0
        for c in range(3):
            total = 0.0
            highest = -np.inf
            for k in range(rgb.shape[1]):
                total += rgb[i, k, c]
                highest = max(highest, rgb[i, k, c])
            # A mirror reflection feeds every channel: one that reads nothing is dead, not dark.
            least = total if not total >= least else least
            brightest += highest / 3
        if not (least > 0 and brightest < BRIGHTEST and brightest > dark_level):
            usable[i] = False
        if not usable[i]:
            rgb[i] = 0


def px_per_mm(camera: Camera) -> float:
    """Pixels a millimetre at the sphere's centre."""
    return camera.fx_px / max(float(np.linalg.norm(camera.centre_mm)), 1.0)
