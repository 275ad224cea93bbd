"""Colour's one pass over the frames, for pixels that a test has as an array."""

from __future__ import annotations

import numpy as np

from processing.lighting.lights import PatternLights
from processing.separation.colour import Readings, separate_window
from processing.separation.config import SeparateConfig
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps


def stored(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Values as a session's frames hold them: float16 of that shape, and what they are times.

    The middle one is about 1, so that hardly anything is too small or too large for half floats.
    """
    lit = np.abs(values[np.isfinite(values) & (values != 0)])
    scale = float(2.0 ** np.round(np.log2(np.median(lit)))) if lit.size else 1.0
    with np.errstate(over="ignore"):
        return (values / scale).astype(np.float16), scale


def as_stored(values: np.ndarray) -> np.ndarray:
    """float32 of what `stored` keeps of values."""
    half, scale = stored(values)
    return half.astype(np.float32) * np.float32(scale)


def separate_at_once(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """What `separate_window` makes of a view's pixels under the lights of the P patterns."""
    mask = pixels.mask
    values = np.zeros((pixels.rgb.shape[1], *mask.shape, 3), np.float32)
    values[:, mask] = pixels.rgb.transpose(1, 0, 2)
    rays = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1, 3), np.float32)
    rays[:-1, :-1][mask] = -pixels.views
    good = np.zeros(mask.shape, bool)
    good[mask] = pixels.valid
    place = np.zeros(3) if pixels.camera is None else pixels.camera.centre_mm
    readings = Readings(*stored(values), mask, good, (0, 0), rays, 1, place, pixels.px_per_mm)
    return separate_window(readings, lights, config)
