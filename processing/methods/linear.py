"""Method `linear`: linear gradients, whose ratios hold the mirror direction without a step.

Under a light that grows evenly from one side to the other a lobe shows the light of its own middle,
however wide it is, so that specular normals come without the saturation that a half sphere's step
brings. Separation is by colour, as with half spheres.
"""

from __future__ import annotations

import numpy as np

from processing.lights import PatternLights, far_field
from processing.methods.config import SeparateConfig
from processing.methods.lobe_fit import maps_by_lobe
from processing.methods.trust import matte_trust
from processing.methods.variants import normal_signal
from processing.normals import solve_far_normals
from processing.pixels import PixelMaps
from processing.readings import read_pixels


def separate_pixels(
    rgb: np.ndarray,
    valid: np.ndarray,
    views: np.ndarray,
    mask: np.ndarray,
    lights: PatternLights,
    px_per_mm: float,
    config: SeparateConfig,
) -> PixelMaps:
    """Separation of one view by chroma and the lobe; arguments as of `colour.separate_pixels`.

    It takes any unpolarised patterns of three directions; `config.normals` other than ``auto`` and
    ``chroma`` take diffuse normals from a channel that holds the mirror reflection.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark, grey or not finite.

    Source: [Ma2007] for linear gradients.
    """
    rgb, signal, saturation, usable = read_pixels(rgb, valid, lights.colour, config.dark_level)
    rgb /= lights.colour.astype(np.float32)
    if config.normals not in ("auto", "chroma"):
        signal = normal_signal(rgb, config.normals)
    normal = solve_far_normals(signal, far_field(lights), views, config.iterations)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    normal[~(usable & (colourful > 0))] = 0
    trust = colourful * matte_trust(signal, normal, views, lights, config)
    return maps_by_lobe(rgb, normal, trust, lights, lights, views, mask, px_per_mm, config.linear)
