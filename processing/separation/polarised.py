"""Method `polarised`: parallel and crossed shots, no colour needed.

Light that scattered in the skin has lost its polarisation, so that a crossed lens shows half of it
and nothing of the mirror reflection, a parallel one the other half and the reflection. Twice the
crossed shot is diffuse, parallel less crossed is specular. The two shots are lit by two banks of
lamps that stand between each other, so that here each is solved with its own bank's light.
"""

from __future__ import annotations

import numpy as np

from lightstage.rig import Camera
from processing.lighting.lights import PatternLights, cells_of
from processing.lighting.polarisers import diffuse_shares, mirror_lights
from processing.pixels import PixelMaps
from processing.readings import read_pixels
from processing.separation.config import SeparateConfig, relief_of
from processing.separation.lobe_fit import maps_by_lobe
from processing.separation.lobe_table import lobe_table, table_lobe
from processing.separation.matte import matte_normals
from processing.separation.variants import beside_centre, noise_of, normal_signal
from processing.surface import Sight


def separate_pixels(
    rgb: np.ndarray,
    valid: np.ndarray,
    views: np.ndarray,
    mask: np.ndarray,
    lights: PatternLights,
    px_per_mm: float,
    config: SeparateConfig,
    *,
    camera: Camera | None = None,
    sight: Sight | None = None,
) -> PixelMaps:
    """Separation of one view's polarised photographs; arguments as of `colour.separate_pixels`.

    Args:
        rgb, valid, views, mask, lights, px_per_mm, config: see there; patterns of both banks.
        camera: whose polariser it is. With it reflections are reckoned as the facets turn them;
            without it all of a parallel shot's reflection passes and none of a crossed one's.
        sight: what the camera sees of a mesh, None for lights far away and no shadows.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark or not finite.

    Source: [Ma2007], [Ghosh2011].
    """
    crossed = np.array([name.endswith("@cross") for name in lights.patterns])
    rgb, _, _, usable = read_pixels(rgb, valid, lights.colour, config.dark_level)
    rgb /= lights.colour.astype(np.float32)
    part = "mean" if config.normals == "auto" else config.normals
    signal = np.ascontiguousarray(normal_signal(rgb, part)[:, crossed])
    banks = lights.of(tuple(np.array(lights.patterns)[crossed]))
    brightness = rgb.mean(axis=2)[:, crossed]
    filtered = None if camera is None else diffuse_shares(lights, camera)
    mirror = lights if camera is None else mirror_lights(lights, camera)
    points = None if camera is None else beside_centre(views, camera)
    told = config.polarised

    def solved(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        noise = noise_of(part, config.noise)
        shares = None if filtered is None else filtered[:, crossed]
        return matte_normals(
            signal, brightness, usable, views, banks, noise, config, sight, shares, points
        )

    normal, trust = solved(signal)
    if camera is not None and part != "chroma" and usable.any():
        # What facets turn of the reflection passes a crossed lens: a typical skin's is taken off.
        table = lobe_table(mirror, views[usable].mean(axis=0), told.roughness)
        leak = table_lobe(table, normal, views, config.roughness)[:, crossed]
        normal, trust = solved(signal - np.float32(told.specular_prior) * leak)
    return maps_by_lobe(
        rgb,
        normal,
        trust,
        lights,
        mirror,
        views,
        mask,
        px_per_mm,
        config.noise,
        relief_of("polarised", config),
        told,
        sight,
        None if filtered is None else filtered[cells_of(normal)],
        points,
    )
