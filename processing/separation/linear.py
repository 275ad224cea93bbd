"""Method `linear`: linear gradients, whose ratios hold the mirror direction without a step.

Under a light that grows evenly from one side to the other a lobe shows the light of its own middle,
however wide it is, so that specular normals come without the saturation that a half sphere's step
brings. Separation is by colour, as with half spheres.
"""

from __future__ import annotations

import numpy as np

from lightstage.rig import Camera
from processing.lighting.lights import PatternLights
from processing.pixels import PixelMaps
from processing.readings import read_pixels
from processing.separation.config import SeparateConfig, relief_of
from processing.separation.lobe_fit import maps_by_lobe
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
    """Separation of one view by chroma and the lobe; arguments as of `colour.separate_pixels`.

    It takes any unpolarised patterns of three directions; `config.normals` other than ``auto`` and
    ``chroma`` take diffuse normals from a channel that holds the mirror reflection.

    Args:
        rgb, valid, views, mask, lights, px_per_mm, config: see there.
        camera: whose view it is; without it every pixel lies at the sphere's centre.
        sight: what the camera sees of a mesh, None for no shadows.

    Returns:
        PixelMaps; confidence 0 and zeros where a pixel is clipped, dark, grey or not finite.

    Source: [Ma2007] for linear gradients.
    """
    rgb, signal, saturation, usable = read_pixels(rgb, valid, lights.colour, config.dark_level)
    rgb /= lights.colour.astype(np.float32)
    part = "chroma" if config.normals == "auto" else config.normals
    if part != "chroma":
        signal = normal_signal(rgb, part)
    colourful = np.clip(saturation / config.grey_saturation - 1, 0, 1)
    usable &= colourful > 0
    points = None if camera is None else beside_centre(views, camera)
    normal, trust = matte_normals(
        signal,
        rgb.mean(axis=2),
        usable,
        views,
        lights,
        noise_of(part, config.noise),
        config,
        sight,
        None,
        points,
    )
    trust *= colourful
    return maps_by_lobe(
        rgb,
        normal,
        trust,
        lights,
        lights,
        views,
        mask,
        px_per_mm,
        config.noise,
        relief_of("linear", config),
        config.linear,
        sight,
        None,
        points,
    )
