"""Method `ratios`: normals from ratios of complements as they were photographed, nothing separated.

What a stage gives without any thought for mirror reflection: the least that others must beat.
"""

from __future__ import annotations

import numpy as np

from processing.lighting.lights import PatternLights
from processing.readings import read_pixels
from processing.separation.config import SeparateConfig
from processing.separation.kampouris import flat_albedo, pair_normals
from processing.separation.pairs import axis_pairs
from processing.separation.variants import normal_signal
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps


def separate_pixels(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """Ratio normals of one view's pixels.

    Args:
        pixels: of the view.
        lights: of their patterns.
        config: see there.

    Returns:
        PixelMaps: one normal for both, `full` less a constant as diffuse albedo, the constant as
        specular albedo; zeros and confidence 0 where a pixel is clipped, dark or not finite.

    Raises:
        ProcessingError: patterns without the three pairs.

    Source: [Ma2007], [Wilson2010].
    """
    options = config.ratios
    pairs = axis_pairs(lights.patterns)
    views = pixels.views
    rgb, _, _, usable = read_pixels(pixels.rgb, pixels.valid, lights.colour, config.dark_level)
    rgb /= lights.colour.astype(np.float32)
    part = "mean" if config.normals == "auto" else config.normals
    signal = normal_signal(rgb, part)[:, pairs.ravel()]
    normal = pair_normals(signal, lights, pairs, views, options.field, config.iterations)
    solved = usable & (np.einsum("nk,nk->n", normal, normal) > 0.5)
    specular = np.where(solved, options.specular, 0.0)
    albedo = flat_albedo(
        rgb, lights, pairs, normal, views, specular, options.field, config.roughness
    )
    normal = np.where(solved[:, None], normal, 0)
    albedo = np.where(solved[:, None], np.maximum(albedo, 0), 0)
    facing = np.clip(np.einsum("nk,nk->n", normal, views) / 0.3, 0, 1)
    roughness = np.where(solved, config.roughness, 0)
    return PixelMaps(normal, normal, albedo, specular, roughness, np.where(solved, facing, 0))
