"""Method `polarised`: parallel and crossed shots, no colour needed.

Light that scattered in the skin has lost its polarisation, so that a crossed lens shows half of it
and nothing of the mirror reflection, a parallel one the other half and the reflection. Twice the
crossed shot is diffuse, parallel less crossed is specular. The two shots are lit by two banks of
lamps that stand between each other, so that here each is solved with its own bank's light.
"""

from __future__ import annotations

import numpy as np

from lightstage.rig import Camera
from processing.lights import PatternLights, far_field
from processing.methods.config import SeparateConfig
from processing.methods.lobe_fit import maps_by_lobe
from processing.methods.polarisers import mirror_lights
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
    *,
    camera: Camera | None = None,
) -> PixelMaps:
    """Separation of one view's polarised photographs; arguments as of `colour.separate_pixels`.

    Args:
        rgb, valid, views, mask, lights, px_per_mm, config: see there; patterns of both banks.
        camera: whose polariser it is. With it reflections are reckoned as the facets turn them;
            without it all of a parallel shot's reflection passes and none of a crossed one's.

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
    normal = solve_far_normals(signal, far_field(banks), views, config.iterations)
    normal[~usable] = 0
    trust = matte_trust(signal, normal, views, banks, config)
    mirror = lights if camera is None else mirror_lights(lights, camera)
    return maps_by_lobe(
        rgb, normal, trust, lights, mirror, views, mask, px_per_mm, config.polarised
    )
