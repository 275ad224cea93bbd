"""Method `linear`: linear gradients, whose ratios hold the mirror direction without a step.

Under a light that grows evenly from one side to the other a lobe shows the light of its own middle,
however wide it is, so that specular normals come without the saturation that a half sphere's step
brings. Separation is by colour, as with half spheres: normals by chroma, the lobe by least squares.
`colour` does the same where it needs more than its one pass over the frames gives: normals of one
channel, or specular normals of their own.
"""

from __future__ import annotations

import numpy as np

from processing.lighting.lights import PatternLights
from processing.readings import read_pixels
from processing.separation.config import Relief, SeparateConfig, relief_of
from processing.separation.lobe_fit import maps_by_lobe
from processing.separation.matte import matte_normals
from processing.separation.variants import noise_of, normal_signal
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps

RELIEF: Relief = "detail"
"""What its specular normals are by itself."""


def separate_pixels(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """Separation of one view's pixels, see `maps_by_chroma`.

    Source: [Ma2007] for linear gradients.
    """
    return maps_by_chroma(pixels, lights, config, relief_of(RELIEF, config))


def maps_by_chroma(
    pixels: Pixels, lights: PatternLights, config: SeparateConfig, relief: str
) -> PixelMaps:
    """Separation of one view's pixels under any unpolarised patterns of three directions.

    Args:
        pixels: of the view.
        lights: of their patterns.
        config: `normals` other than ``auto`` and ``chroma`` take diffuse normals from a channel
            that holds the mirror reflection; the lobe is fitted by `linear`.
        relief: what specular normals are: ``mirror``, ``detail`` or ``diffuse``.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark, grey or not finite.

    Source: [Mallick2005] for chroma.
    """
    rgb, signal, saturation, usable = read_pixels(
        pixels.rgb, pixels.valid, lights.colour, config.dark_level
    )
    rgb /= lights.colour.astype(np.float32)
    part = "chroma" if config.normals == "auto" else config.normals
    if part != "chroma":
        signal = normal_signal(rgb, part)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    usable &= colourful > 0
    noise = noise_of(part, config.noise)
    normal, trust = matte_normals(signal, rgb.mean(axis=2), usable, pixels, lights, noise, config)
    trust *= colourful
    return maps_by_lobe(
        pixels, rgb, normal, trust, lights, lights, config.noise, relief, config.linear
    )
