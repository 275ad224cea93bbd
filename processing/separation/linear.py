"""Method `linear`: linear gradients, whose ratios hold the mirror direction without a step.

Under a light that grows evenly from one side to the other a lobe shows the light of its own middle,
however wide it is, so that specular normals come without the saturation that a half sphere's step
brings. Separation is by colour, as with half spheres.
"""

from __future__ import annotations

from processing.lighting.lights import PatternLights
from processing.separation.chroma import maps_by_chroma
from processing.separation.config import SeparateConfig, relief_of
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps


def separate_pixels(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """Separation of one view's pixels, see `maps_by_chroma`.

    Source: [Ma2007] for linear gradients.
    """
    return maps_by_chroma(pixels, lights, config, relief_of("linear", config))
