"""Method `polarised`: parallel and crossed shots, no colour needed.

Light that scattered in the skin has lost its polarisation, so that a crossed lens shows half of it
and nothing of the mirror reflection, a parallel one the other half and the reflection. Twice the
crossed shot is diffuse, parallel less crossed is specular. The two shots are lit by two banks of
lamps that stand between each other, so that here each is solved with its own bank's light.
"""

from __future__ import annotations

import numpy as np

from processing.lighting.lights import PatternLights, cells_of
from processing.lighting.polarisers import diffuse_shares, mirror_lights
from processing.readings import read_pixels
from processing.separation.config import Relief, SeparateConfig, relief_of
from processing.separation.lobe_fit import maps_by_lobe
from processing.separation.lobe_table import lobe_table, table_lobe
from processing.separation.matte import matte_normals
from processing.separation.variants import noise_of, normal_signal
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps

RELIEF: Relief = "mirror"
"""What its specular normals are by itself."""


def separate_pixels(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """Separation of one view's polarised photographs.

    Args:
        pixels: of the view. With their camera reflections are reckoned as the facets turn them;
            without it all of a parallel shot's reflection passes and none of a crossed one's.
        lights: of their patterns, of both banks.
        config: see there.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark or not finite.

    Source: [Ma2007], [Ghosh2011].
    """
    camera, views = pixels.camera, pixels.views
    crossed = np.array([name.endswith("@cross") for name in lights.patterns])
    rgb, _, _, usable = read_pixels(pixels.rgb, pixels.valid, lights.colour, config.dark_level)
    rgb /= lights.colour.astype(np.float32)
    part = "mean" if config.normals == "auto" else config.normals
    signal = np.ascontiguousarray(normal_signal(rgb, part)[:, crossed])
    bank = lights.of(tuple(np.array(lights.patterns)[crossed]))
    brightness = rgb.mean(axis=2)[:, crossed]
    filtered = None if camera is None else diffuse_shares(lights, camera)
    mirror = lights if camera is None else mirror_lights(lights, camera)
    noise, options = noise_of(part, config.noise), config.polarised

    def solved(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shares = None if filtered is None else filtered[:, crossed]
        return matte_normals(signal, brightness, usable, pixels, bank, noise, config, shares)

    normal, trust = solved(signal)
    if camera is not None and part != "chroma" and usable.any():
        # What facets turn of the reflection passes a crossed lens: a typical skin's is taken off.
        table = lobe_table(mirror, views[usable].mean(axis=0), options.roughness)
        leak = table_lobe(table, pixels.places_mm, normal, views, config.roughness)[:, crossed]
        normal, trust = solved(signal - np.float32(options.specular_prior) * leak)
    shares = None if filtered is None else filtered[cells_of(normal)]
    relief = relief_of(RELIEF, config)
    return maps_by_lobe(
        pixels, rgb, normal, trust, lights, mirror, config.noise, relief, options, shares
    )
